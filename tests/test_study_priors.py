"""Priors that follow from a study, and the table and option that change them."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pymc as pm
import pytest

import zoo
from zoo import load_study
from zoo.blood.baseline import Baseline, get_baseline
from zoo.blood.blood_flow import constant_stiffness
from zoo.blood.case import wall_slope
from zoo.blood.network import Network
from zoo.blood.prior_predictive import prior_predictive, prior_rows
from zoo.blood.prior_tables import PriorsError, read_option, read_priors, table_of
from zoo.blood.solver import SolverOptions
from zoo.blood.study import Blood, Study, StudyError, Vessel, Windkessel, save_study
from zoo.blood.study_priors import GAMMA, stiffness_of_wave_speed, with_priors
from zoo.core.arviz_lines import InferenceData
from zoo.core.inference.record import RunRecord
from zoo.core.parameters import (
    InverseGamma,
    LogNormal,
    LogUniform,
    Normal,
    Parameter,
    Prior,
    Uniform,
    draw_prior,
)
from zoo.core.posterior.files import mismatch
from zoo.models import MODELS, get_model

EXAMPLE = Path(__file__).parents[1] / "docs" / "example-study"
DENSITY = 1.055


def priors_of(study: Study, baseline: str = "B", **settings: object) -> dict[str, Prior]:
    """By the parameters' names."""
    forward = get_baseline(baseline).forward(study, **settings)  # type: ignore[arg-type]
    return {p.name: p.prior for p in forward.parameters}


@pytest.fixture(scope="module")
def example() -> Study:
    return load_study(EXAMPLE)


# ---------------------------------------------------------------------------------------------------
# What follows from a study


@pytest.mark.parametrize(("wall", "baseline"), [("linear", "B"), ("tangent", "H")])
def test_stiffness_follows_from_the_wave_speed_of_the_solvers_wall(
    wall: str, baseline: str, example: Study
) -> None:
    """rho c^2 = dp/d(A/A0) of the wall that is solved, gamma at its median."""
    case = get_baseline(baseline).forward(example)
    theta = [stiffness_of_wave_speed(3.0, wall, DENSITY), *([GAMMA.centre] if wall == "tangent" else [])]
    slope = wall_slope(case.configure([*theta, 1.0, 1.0, 1.0]))
    np.testing.assert_allclose(np.sqrt(slope / DENSITY), 300.0, rtol=1e-12)


def test_stiffnesses_of_mice_and_men_are_in_the_bulk(example: Study) -> None:
    """Away from the outer 5 % at either end: wave speeds of 1.8 to 15 m/s."""
    low, high = priors_of(example)["f3"].quantile([0.05, 0.95])
    mouse, human_leg = 5e4, 3.5e6
    assert low < mouse < human_leg < high


def test_wave_speeds_of_the_table_hold_95_percent(example: Study) -> None:
    study = replace(example, priors={"wave_speed_m_s": [2.0, 5.0]})
    for name, parameter in (("B", "f3"), ("E", "f3"), ("G", "m_chi"), ("H", "f3")):
        prior = priors_of(study, name)[parameter]
        wall = "tangent" if name == "H" else "linear"
        ends = [stiffness_of_wave_speed(c, wall, DENSITY) for c in (2.0, 5.0)]
        np.testing.assert_allclose(prior.quantile([0.025, 0.975]), ends, rtol=1e-6)


def test_f2_counts_in_the_radii_of_the_study(example: Study) -> None:
    """The same vessels ten times as wide, or a unit ten times as large: f2 r0/u has the same prior."""
    sizes = [(v, 10 * v.radius_cm, 10 * v.radius_out_cm) for v in example.vessels]
    wide = replace(example, vessels=[replace(v, radius_cm=r, radius_out_cm=out) for v, r, out in sizes])
    unit = example.conventions.replace(stiffness_radius_unit_cm=10.0)
    own = priors_of(example, "E")["f2"].quantile([0.1, 0.9])
    np.testing.assert_allclose(priors_of(wide, "E")["f2"].quantile([0.1, 0.9]), own / 10)
    np.testing.assert_allclose(priors_of(example, "E", conventions=unit)["f2"].quantile([0.1, 0.9]), 10 * own)
    radii = Network.from_study(example).radius_in_cm
    narrowing = np.exp(np.outer(priors_of(example, "E")["f2"].quantile([0.5, 0.975]), radii))
    assert 0.01 < narrowing[0].min() < narrowing[0].max() < 0.9  # it tells wide vessels from narrow ones
    assert narrowing[1].min() > 0.3  # and may hardly do so


def test_vessels_of_one_population_differ_by_a_factor_of_two(example: Study) -> None:
    """Relative to their median, whatever that is."""
    forward = get_baseline("G").forward(example)
    rng = np.random.default_rng(1)
    draws = np.array([draw_prior(forward.parameters, rng)[:5] for _ in range(4000)])
    spread = np.log(draws[:, 2:5] / draws[:, :1])
    assert np.exp(np.std(spread)) == pytest.approx(1.5, abs=0.1)
    assert abs(np.corrcoef(np.log(draws[:, 0]), spread[:, 0])[0, 1]) < 0.05


@pytest.mark.parametrize("name", ["A", "E", "G", "I"])
def test_most_prior_draws_can_be_solved(name: str, example: Study) -> None:
    found = prior_predictive(get_model(name)(example), n_draws=30)
    assert len(found.series) + sum(found.failures.values()) == 30
    assert len(found.series) >= 0.8 * 30
    assert "of 30 prior draws could be solved" in found.text
    # what was observed lies in the band of most of the beat
    low, high = np.quantile(found.series[:, 0], (0.025, 0.975), axis=0)
    observed = example.series[0].value
    assert np.mean((observed > low) & (observed < high)) > 0.8


def test_prior_draws_of_a_human_tree_can_be_solved() -> None:
    """An aorta with two branches, pressures of men: the same priors hold it."""
    t = np.arange(64) / 64
    study = Study(
        "aorta", 1.0, Blood(1.06, 0.035),
        [
            Vessel(1, "aorta", 20.0, 1.2, 1.0),
            Vessel(2, "left", 15.0, 0.6, 0.5, 1, Windkessel(300.0, 3000.0, 3e-4)),
            Vessel(3, "right", 15.0, 0.6, 0.5, 1, Windkessel(300.0, 3000.0, 3e-4)),
        ],
        t, 300.0 * np.maximum(0.0, np.sin(np.pi * np.minimum(t / 0.35, 1.0))) + 5.0, [], [],
    )  # fmt: skip
    forward = get_baseline("B").forward(study, options=SolverOptions(dx_cm=1.0))
    rng = np.random.default_rng(1)
    means = []
    for _ in range(12):
        outputs = zoo.core.forward.Outputs(((1, 0.0, "pressure_mmHg"),), t)
        means.append(forward.solve(forward.configure(draw_prior(forward.parameters, rng)), outputs).mean())
    assert 40 < np.median(means) < 250


# ---------------------------------------------------------------------------------------------------
# Whose priors


@pytest.mark.parametrize("name", MODELS)
def test_the_papers_set_is_what_stands_in_the_models_file(name: str, example: Study) -> None:
    """Bit for bit, with its starts; any other study has no start but the median of a prior of its own."""
    baseline = get_baseline(name)
    paper = baseline.forward(example, priors={"set": "paun2020"})
    for own, stated in zip(paper.parameters, baseline.parameters, strict=True):
        assert own == replace(stated, size=own.size)
    for own, stated in zip(baseline.forward(example).parameters, baseline.parameters, strict=True):
        assert own.prior != stated.prior
        assert own.start is None
        assert (own.name, own.unit, own.dims) == (stated.name, stated.unit, stated.dims)


def test_a_baseline_of_ones_own_keeps_its_priors(example: Study) -> None:
    mine = Baseline("mine", "linear", constant_stiffness, (Parameter("f3", LogUniform(1e4, 1e6)),))
    assert mine.forward(example).parameters[0].prior == LogUniform(1e4, 1e6)


@pytest.mark.needs_data
def test_only_the_papers_mouse_has_the_papers_priors() -> None:
    for name in ("demo", "mouse-h1", "mouse-c6"):
        paper = priors_of(load_study(name))["f3"] == Uniform(2e4, 1e5)
        assert paper == (name == "mouse-c6")


def test_priors_are_changed_by_name(example: Study) -> None:
    """In study.toml, as argument of a model and of its forward model; the argument goes first."""
    own = replace(example, priors={"stiffness": {"log_uniform": [2e4, 4e5]}, "c": {"normal": [1, 0.1]}})
    assert priors_of(own)["f3"] == LogUniform(2e4, 4e5)
    assert priors_of(own, "G")["m_chi"] == LogUniform(2e4, 4e5)
    assert priors_of(own)["c"] == Normal(1.0, 0.1)
    again = priors_of(own, priors={"c": LogNormal(1.0, 0.2)})
    assert (again["c"], again["f3"]) == (LogNormal(1.0, 0.2), LogUniform(2e4, 4e5))
    model = zoo.model_A(own, priors={"psi1": Uniform(0.1, 1.0)})
    assert model.zoo.priors["psi1"] == "uniform in [0.1, 1]"
    assert model.zoo.priors["f3"] == "log-uniform in [20000, 400000]"


def test_priors_of_the_errors_are_changed_too(example: Study) -> None:
    model = zoo.model_A(example, priors={"noise_pressure_mmHg": LogUniform(0.01, 1.0)})
    assert model.zoo.priors["noise_pressure_mmHg"] == "log-uniform in [0.01, 1]"
    paper = zoo.model_A(example, priors={"set": "paun2020", "sigma2": LogUniform(0.01, 1.0)})
    assert paper.zoo.priors["sigma2"] == "log-uniform in [0.01, 1]"


def test_the_starts_of_a_search_are_finite_for_any_study(example: Study) -> None:
    for name in MODELS:
        model = get_model(name)(example)
        assert all(np.all(np.isfinite(value)) for value in model.zoo.suggested.values())
        assert float(model.zoo.suggested["psi1"]) == 1.0


def test_rows_of_the_table_say_where_priors_came_from(example: Study) -> None:
    model = zoo.model_B(replace(example, priors={"c": {"log_uniform": [0.5, 2.0]}}))
    rows = {row.parameter.name: row for row in prior_rows(model)}
    assert "wave speeds of 0.7 to 20 m/s" in rows["f3"].origin
    assert (rows["psi1"].origin, rows["c"].origin) == ("given and nominal loads", "given")
    for load, words in ((None, "nominal loads"), (Windkessel(3e4, 1e5, 7e-7), "given loads")):
        vessels = tuple(replace(v, windkessel=v.parent and load) for v in example.vessels)
        found = prior_rows(zoo.model_B(replace(example, vessels=vessels)))
        assert {row.origin for row in found if row.parameter.name in ("psi1", "psi2", "c")} == {words}
    assert (rows["c"].median, rows["c"].low) == pytest.approx((1.0, 0.5 * 4**0.025))
    chi = {row.parameter.name: row for row in prior_rows(zoo.model_G(example))}["chi"]
    m_chi = {row.parameter.name: row for row in prior_rows(zoo.model_G(example))}["m_chi"]
    assert chi.median == pytest.approx(m_chi.median, rel=0.15)
    assert chi.low < m_chi.low < m_chi.high < chi.high


# ---------------------------------------------------------------------------------------------------
# The table and the option


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"set": "paun"}, r"set = 'paun': unknown; did you mean 'paun2020'\? use one of"),
        ({"sett": "study"}, r"sett = 'study': did you mean the field 'set'\?"),
        ({"f3": {"uniform": [1, 2], "normal": [1, 2]}}, "a parameter has one law"),
        ({"f3": {"loguniform": [1, 2]}}, r"f3: 'loguniform': unknown law; did you mean 'log_uniform'\?"),
        ({"f3": {"normal": [1, 2, 3]}}, r"must be \[mean, sd\] or \[mean, sd, low, high\]"),
        ({"f3": {"uniform": [2, 1]}}, r"f3: uniform = \[2, 1\]: .*ascend"),
        ({"f3": {"log_normal": [1, 0]}}, r"f3: log_normal = \[1, 0\]: .*positive"),
        ({"chi": {"uniform": [1, 2]}}, "chi: is a population of stiffnesses; give m_chi or v_chi"),
        ({"wave_speed_m_s": [4, 1]}, r"wave_speed_m_s = \[4, 1\]: must ascend"),
        ({"wave_speed_m_s": [100, 2000]}, r"correct the numbers or their unit"),
        ({"set": "paun2020", "wave_speed_m_s": [1, 4]}, "has a stiffness of its own; leave out one"),
    ],
)
def test_mistakes_in_the_table_are_one_line_each(
    table: dict[str, object], words: str, example: Study, tmp_path: Path
) -> None:
    with pytest.raises(PriorsError, match=words) as error:
        read_priors(table)
    assert "\n" not in str(error.value)
    folder = tmp_path / "study"
    save_study(replace(example, priors=table), folder)
    with pytest.raises(StudyError, match=f"study.toml: priors: .*{words}"):
        load_study(folder)
    with pytest.raises(PriorsError, match=words):
        zoo.model_A(example, priors=table)


def test_a_parameter_that_no_model_has_is_refused_with_the_nearest(example: Study) -> None:
    for name in ("psi3", "F3", "stifness"):
        study = replace(example, priors={name: {"uniform": [1.0, 2.0]}})
        with pytest.raises(PriorsError, match=rf"example-study.*priors: {name}: unknown; did you mean"):
            zoo.model_A(study)
        with pytest.raises(PriorsError, match=name):
            zoo.diagnose(study)
    with pytest.raises(PriorsError, match="did you mean 'noise_pressure_mmHg'"):
        zoo.model_A(example, priors={"noise_pressure": {"uniform": [1.0, 2.0]}})
    # f1 is of other models: a study may give it, model A has no use for it
    zoo.model_A(example, priors={"f1": {"uniform": [1.0, 2.0]}})


@pytest.mark.parametrize(
    ("text", "table"),
    [
        ("f3=log_uniform(2e4,4e5)", {"f3": {"log_uniform": [2e4, 4e5]}}),
        ("stiffness = normal( 5e4, 1e4, 0, inf )", {"stiffness": {"normal": [5e4, 1e4, 0.0, math.inf]}}),
        ("wave_speed_m_s=1,4", {"wave_speed_m_s": [1.0, 4.0]}),
        ("wave_speed_m_s=[1, 4]", {"wave_speed_m_s": [1.0, 4.0]}),
        ("set=paun2020", {"set": "paun2020"}),
    ],
)
def test_the_option_says_what_the_table_does(text: str, table: dict[str, object]) -> None:
    name, value = read_option(text)
    assert {name: value} == table
    read_priors(table)


@pytest.mark.parametrize("text", ["f3", "=uniform(1,2)", "f3=", "f3=uniform(1;2)", "f3=uniform(a,b)"])
def test_an_option_that_cannot_be_read_is_refused(text: str) -> None:
    with pytest.raises(PriorsError, match=r"write NAME=LAW|not numbers"):
        read_option(text)


@pytest.mark.parametrize("text", ["f3=2e4,4e5", "f3=log_uniform(2e4", "sett=paun2020"])
def test_an_option_without_a_law_is_shown_one_as_it_is_typed(text: str) -> None:
    with pytest.raises(PriorsError, match=r"one law, such as \w+=log_uniform\(2e4,4e5\)"):
        read_option(text)


@pytest.mark.parametrize(
    "prior",
    [Uniform(1, 2), LogUniform(1, 2), Normal(0, 1), Normal(0, 1, -1, 1), LogNormal(1, 2), InverseGamma(3, 1)],
)
def test_a_prior_goes_into_a_table_and_comes_back(prior: Prior) -> None:
    assert read_priors({"f3": table_of(prior)}).own["f3"] == prior


def test_a_table_is_saved_and_read_back(example: Study, tmp_path: Path) -> None:
    study = with_priors(example, {"f3": LogUniform(2e4, 4e5), "wave_speed_m_s": [1.0, 4.0]})
    save_study(study, tmp_path / "s")
    assert load_study(tmp_path / "s").priors == study.priors
    assert study.checksum == example.checksum


# ---------------------------------------------------------------------------------------------------
# The record of a run


def a_few(model: pm.Model) -> InferenceData:
    return zoo.sample(model, draws=4, tune=8, chains=1, cores=0, progress=False, until_ess=None, seed=1)


def test_a_posterior_of_other_priors_is_named_as_such(example: Study) -> None:
    model = zoo.model_A(example)
    idata = a_few(model)
    record = RunRecord.of(idata)
    assert record.priors == model.zoo.priors
    assert mismatch(idata, model) is None
    other = zoo.model_A(example, priors={"c": {"log_uniform": [0.5, 2.0]}})
    assert mismatch(idata, other) == "prior of c is log-normal(1, 1), here it is log-uniform in [0.5, 2]"
    replace(record, priors=None).attach(idata)  # as of before
    assert mismatch(idata, other) is None


def test_a_posterior_of_another_grid_is_named_as_such(example: Study) -> None:
    models = [zoo.model_A(replace(example, numerics=n)) for n in ({"dx_cm": 0.5}, {"dx_cm": 0.25})]
    idata = a_few(models[0])
    assert mismatch(idata, models[0]) is None
    assert mismatch(idata, models[1]) == "dx_cm is 0.5, here it is 0.25"
    more = zoo.model_A(replace(example, numerics={"dx_cm": 0.5, "max_beats": 99}))
    assert mismatch(idata, more) is None  # a limit shapes no solution


def test_a_posterior_of_another_noise_is_named_as_such(example: Study) -> None:
    models = [zoo.model_A(replace(example, noise_sd=sd)) for sd in ({}, {"pressure_mmHg": 0.5})]
    other = zoo.model_A(replace(example, noise_sd={"pressure_mmHg": 3.0}))
    free, known = map(a_few, models)
    assert mismatch(free, models[0]) is None
    assert mismatch(known, models[1]) is None
    label = example.series[0].label
    assert mismatch(known, other) == f"noise of {label} is known, 0.5 mmHg, here it is known, 3 mmHg"
    assert mismatch(free, other) == f"noise of {label} is none, here it is known, 3 mmHg"
    said = mismatch(known, models[0]) or ""
    assert said.startswith("prior of noise_pressure_mmHg is none, here it is log-normal")


def test_a_prior_that_reaches_below_zero_names_the_field(example: Study) -> None:
    given = with_priors(example, {"f3": Uniform(-1.0, 1.0)})
    with pytest.raises(
        PriorsError, match=r"priors: f3 = .*must be positive, and begins at -1; give it bounds"
    ):
        priors_of(given)
