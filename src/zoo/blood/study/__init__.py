"""Studies: a vessel tree, its inflow over one beat, and what was observed, as a folder of four files.

``study.toml`` names the others: ``network.toml`` (blood and vessels), ``inflow.csv`` and
``observations.csv``. Everything is checked when it is loaded, and an error says in one line which file,
row and field is wrong, what it holds, and what to do.
"""

from zoo.blood.study.loading import LoadWarning, list_studies, load_study, root_pressure, study_files
from zoo.blood.study.parts import (
    QUANTITIES,
    Blood,
    ReadOnlyArrays,
    Series,
    Stenosis,
    StudyError,
    Vessel,
    Windkessel,
    read_only,
)
from zoo.blood.study.resampling import even_samples
from zoo.blood.study.samples import INFLOW_COLUMNS, MIN_SAMPLES, OBSERVATION_COLUMNS
from zoo.blood.study.saving import STUDY_FILES, save_study
from zoo.blood.study.study import JUNCTION_PRESSURES, Study
from zoo.blood.study.suspicion import Suspicion, UnitWarning, suspect_units
from zoo.blood.study.tree import check_physics, sort_vessels
