"""Figures; only the modules of this package import matplotlib.

A function takes results and returns a `matplotlib.figure.Figure`, which `save_figure` writes.
"""

from zoo.plots.blindcheck import score_figures
from zoo.plots.causes import plot_causes, plot_functions, plot_sensitivity
from zoo.plots.chains import pair_figure, rank_figure, trace_figure
from zoo.plots.diagnosis_figures import plot_diagnosis, plot_discrepancy, plot_where
from zoo.plots.fit import fit_figure
from zoo.plots.model_comparison import comparison_figure, forest_figure, loo_pit_figure
from zoo.plots.other_states import plot_states
from zoo.plots.prior_densities import prior_predictive_figure, priors_figure
from zoo.plots.style import (
    PARAMETER_LABELS,
    QUANTITY_LABELS,
    FigureError,
    figure_path,
    model_style,
    save_figure,
)
from zoo.plots.waves import all_vessels_figure, loops_figure, models_figure, waves_figure
