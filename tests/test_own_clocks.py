"""Series on clocks of their own, and with samples missing: as if each had the samples that it has."""

import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
from scipy.stats import multivariate_normal

import zoo
from zoo.core.causes.evidence import SetModel
from zoo.core.causes.family import ErrorFamily
from zoo.core.causes.problem import Cause, Problem
from zoo.core.data import Data, DataError
from zoo.core.diagnosis.coordinates import ranges
from zoo.core.errors.base import ErrorModelError
from zoo.core.errors.spectral import Cosines, GroupErrors, Harmonics, Uneven, log_density, spectral_errors
from zoo.core.errors.variables import IidErrors
from zoo.core.forward import FunctionModel, Outputs
from zoo.core.parameters import as_parameters

ROOT = Path(__file__).parent.parent
SHARED = Path(os.environ.get("ZOO_DATA_DIR", ROOT.parent / "shared" / "data")).parent

FINE = 2048
EVEN = np.arange(64) / 64
MISSING = np.delete(EVEN, [5, 20, 33])
FASTER = np.rint(np.arange(96) / 96 * FINE) / FINE


def own(clocks: list[np.ndarray], values: list[np.ndarray] | None = None, **settings: object) -> Data:
    found = [np.zeros(len(clock)) for clock in clocks] if values is None else values
    return Data(clocks, found, groups=["y"] * len(clocks), **settings)  # type: ignore[arg-type]


def test_series_of_their_own_times_are_on_one_grid_and_not_measured_elsewhere() -> None:
    first, second = np.array([0.0, 0.1, 0.3]), np.array([0.0, 0.2, 0.1 * 3, 0.4])
    data = own([first, second], [np.array([1.0, 2, 3]), np.array([4.0, 5, 6, 7])])
    np.testing.assert_allclose(data.times, [0, 0.1, 0.2, 0.3, 0.4])
    np.testing.assert_array_equal(data.values, [[1, 2, np.nan, 3, np.nan], [4, np.nan, 5, 6, 7]])
    assert not data.even
    assert not data.whole
    masked = Data(data.times, np.ma.masked_invalid(data.values), groups=["y"] * 2)
    assert masked.checksum == data.checksum
    with pytest.raises(DataError, match="series 1 has 4 values and 3 times: give one value for each"):
        own([first, first], [np.zeros(3), np.zeros(4)])
    with pytest.raises(DataError, match="times of series 0 must be finite and ascend"):
        own([first[::-1], second])


@pytest.mark.parametrize("period", [None, 1.0])
@pytest.mark.parametrize("other", [MISSING, FASTER])
def test_the_density_is_nearly_that_of_the_covariance_without_what_is_missing(
    period: float | None, other: np.ndarray
) -> None:
    """Beside white noise a smooth process that two series nearly share."""
    errors = GroupErrors(0.1, delta=1.0, length=0.05, shared=0.9)
    whole = (Cosines() if period is None else Harmonics()).bind(
        Data(np.arange(FINE) / FINE, np.zeros((1, FINE)), period=period)
    )
    spectrum = np.exp(-0.5 * (whole.omega * errors.length) ** 2)
    K = whole._basis.T @ ((spectrum / spectrum.mean())[:, None] * whole._basis)
    at = [np.rint(clock * FINE).astype(int) for clock in (EVEN, other)]
    dense = np.block([[K[np.ix_(a, b)] * (1.0 if a is b else errors.shared) for b in at] for a in at])
    dense += errors.sigma**2 * np.eye(len(dense))
    y = np.random.default_rng(3).multivariate_normal(np.zeros(len(dense)), dense, 60)
    exact = multivariate_normal(np.zeros(len(dense)), dense).logpdf(y)
    data = own([EVEN, other], period=period)
    H = spectral_errors(data).bind(data)
    assert isinstance(H, Uneven)
    series = np.full((60, *data.values.shape), np.nan)
    series[:, data.measured] = y
    z = H.flat(series)
    np.testing.assert_allclose(np.sum(z**2, axis=1), np.sum(y**2, axis=1))
    np.testing.assert_allclose(H.unflat(z), series, atol=1e-12)  # NaN where not measured
    assert np.mean(np.abs(log_density(z, H.variances({"y": errors})) - exact)) < 1.5
    alone = GroupErrors(0.1, delta=1.0, length=0.05)
    assert np.mean(exact - log_density(z, H.variances({"y": alone}))) > 10.0


def test_the_evidence_is_that_of_the_rows_that_are_left() -> None:
    """Normal parameters and an effect, known white noise: a normal density of the measured samples."""
    rng, clocks, sigma = np.random.default_rng(1), [MISSING, FASTER], 0.3
    t = np.concatenate(clocks)
    first = np.repeat([1.0, 0.0], [len(clock) for clock in clocks])
    J, R = np.stack([np.sin(5 * t), first], axis=1), np.cos(9 * t)[:, None]
    y = J @ [0.5, -0.4] + 0.7 * R[:, 0] + sigma * rng.standard_normal(len(t))
    data = own(clocks, np.split(y, [len(MISSING)]))
    errors = spectral_errors(data).bind(data)
    family = ErrorFamily(errors, ranges(data), {"y": sigma})

    def flat(columns: np.ndarray) -> np.ndarray:
        series = np.full((columns.shape[1], *data.values.shape), np.nan)
        series[:, data.measured] = columns.T
        return errors.flat(series).T

    sd = np.array([2.0, 3.0])
    log_prior = -np.sum(np.log(sd)) - np.log(2 * np.pi)
    problem = Problem(errors.flat(data.values), flat(J), sd**-2.0, np.zeros(2), log_prior)
    for effects in ([], [Cause("wave", "any", flat(R))]):
        found = SetModel(problem, effects, family).given(np.array([0]), np.log([sigma]))
        A = np.concatenate([J * sd, R], axis=1) if effects else J * sd
        exact = multivariate_normal(np.zeros(len(t)), A @ A.T + sigma**2 * np.eye(len(t))).logpdf(y)
        assert found.log_z[0] == pytest.approx(exact, abs=1e-6)


def pulses(c: dict, t: np.ndarray) -> np.ndarray:
    """Two sensors of a pulse, the second later; `c` may have a kick of its third harmonic."""

    def drive(at: np.ndarray) -> np.ndarray:
        wave = c["level"] * (np.exp(np.cos(2 * np.pi * (at - 0.3))) - 1.3)
        return wave + c.get("kick", 0.0) * np.sin(6 * np.pi * at)

    return np.stack([drive(t), c["part"] * drive(t - 0.08)])


@zoo.effect("kick", "inflow", parameters=[zoo.EffectParameter("size", "1", 0.3, -2.0, 2.0, (0.1, -0.1))])
def kick(c, values, location):  # type: ignore[no-untyped-def]
    """The third harmonic of the drive."""
    return {**c, "kick": values[0]}


@zoo.effect("offset", "sensor", parameters=[zoo.EffectParameter("size", "1", 0.3, -2.0, 2.0, (0.1, -0.1))])
def offset(c, values, location):  # type: ignore[no-untyped-def]
    """The level is another one in the second sensor."""
    return {**c, "part": c["part"] * (1.0 + values[0])}


PRIORS = {"level": zoo.Normal(1.0, 0.3), "part": zoo.Normal(0.6, 0.3)}


def diagnosed(times: object, values: object) -> zoo.Diagnosis:
    return zoo.diagnose(  # type: ignore[call-overload,no-any-return]
        times, values, pulses, PRIORS, [kick, offset], period=1.0, progress=False
    )


def lead(found: zoo.Diagnosis) -> float:
    """Log evidence of the kick over that of nothing."""
    log = {tuple(row.names): row.log_evidence for row in found.table}
    return log["kick",] - log[()]


def test_a_record_with_gaps_on_two_clocks_has_the_same_cause_and_nearly_its_evidence() -> None:
    rng, t = np.random.default_rng(2), np.arange(128) / 128
    full = pulses({"level": 1.1, "part": 0.6, "kick": 0.03}, t) + 0.02 * rng.standard_normal((2, 128))
    whole = diagnosed(t, full)
    gone = np.where(rng.random(full.shape) < 0.05, np.nan, full)
    thinned = diagnosed(t, gone)
    clocks = [t[np.isfinite(row)] for row in gone]
    apart = diagnosed(clocks, [row[np.isfinite(row)] for row in gone])
    assert lead(apart) == pytest.approx(lead(thinned), abs=1e-6)
    assert whole.cause == thinned.cause == ["kick"]
    assert lead(whole) > 20.0
    assert lead(thinned) == pytest.approx(lead(whole), rel=0.15)
    one, other = (x.causes[0].estimates[0] for x in (whole, thinned))
    assert other.mean == pytest.approx(one.mean, abs=2.0 * one.sd)
    assert np.isnan(thinned.computed[0][~np.isfinite(gone[:, np.isfinite(gone).any(axis=0)])]).all()
    assert len(thinned.predict()) == np.isfinite(gone).sum()
    thinned.plot()


def test_posteriors_of_series_on_their_own_clocks_are_refused_with_what_to_take() -> None:
    data = own([MISSING, FASTER])
    model = FunctionModel(pulses, as_parameters(PRIORS), Outputs(data.outputs, data.times))
    with pytest.raises(ErrorModelError, match=r"sample with GroupNoise\(\) or GroupProcess\(\)"):
        zoo.bayesian_model("pulses", model, data, Uneven())


@pytest.mark.parametrize("errors", [zoo.Independent(), zoo.GroupNoise()])
def test_a_model_has_the_density_of_the_samples_that_there_are(errors: zoo.ErrorModel) -> None:
    rng, sd = np.random.default_rng(4), 1.3
    data = own([MISSING, FASTER], [rng.standard_normal(len(clock)) for clock in (MISSING, FASTER)])
    bound, mean = errors.bind(data), pulses({"level": 1.0, "part": 0.6}, data.times)
    [noise] = bound.parameters
    value = {noise.name: sd**2 if noise.name == "sigma2" else sd}
    off = (data.values - mean)[data.measured]
    exact = multivariate_normal(np.zeros(len(off)), sd**2 * np.eye(len(off))).logpdf(off)
    assert bound.log_density(data.values - mean, value) == pytest.approx(exact)
    with pm.Model(coords={"series": data.labels, "time": data.times}) as model:
        bound.observe("y", mean, np.int8(1), value)
    assert model.compile_logp(vars=[model["y"]])({}) == pytest.approx(exact)


def test_what_was_not_measured_has_no_part_in_a_gradient() -> None:
    shift = pt.dscalar()
    observed, mean = np.array([[1.0, np.inf, 3.0]]), np.zeros((1, 3))
    terms = pm.logp(IidErrors.dist(mean + shift, np.int8(1), 4.0), observed)
    slope = pytensor.function([shift], pytensor.grad(terms.sum(), shift), mode="FAST_COMPILE")
    assert slope(0.0) == pytest.approx(1.0)


@pytest.mark.slow
def test_samples_and_scores_of_series_on_their_own_clocks() -> None:
    """WAIC has as many terms as there are samples, and nothing is imputed."""
    rng = np.random.default_rng(5)
    clocks = [MISSING, FASTER]
    values = [
        pulses({"level": 1.1, "part": 0.5}, clock)[i] + 0.1 * rng.standard_normal(len(clock))
        for i, clock in enumerate(clocks)
    ]
    data = own(clocks, values)
    outputs = Outputs(data.outputs, data.times)
    model = zoo.bayesian_model(
        "pulses", FunctionModel(pulses, as_parameters(PRIORS), outputs), data, zoo.GroupNoise()
    )
    idata = zoo.sample(model, draws=500, tune=500, chains=2, cores=0, seed=1, progress=False)
    assert set(idata.posterior.data_vars) == {"level", "part", "noise_y"}
    for name, truth in {"level": 1.1, "part": 0.5, "noise_y": 0.1}.items():
        x = idata.posterior[name]
        assert abs(float(x.mean()) - truth) < 4 * float(x.std())
    table = zoo.compare({"pulses": idata}, {"pulses": model})
    assert len(table.attrs["terms"]["pulses"]) == len(MISSING) + len(FASTER)
    assert table.loc["pulses", "sse_y"] == pytest.approx(0.01 * (len(MISSING) + len(FASTER)), rel=0.4)


def test_processes_of_each_series_are_of_its_own_samples() -> None:
    """The density, its gradient and its leave-one-out terms are those of each series by itself."""
    rng = np.random.default_rng(6)
    values = [rng.standard_normal(len(clock)) for clock in (MISSING, FASTER)]
    data = own([MISSING, FASTER], values, period=1.0)
    bound = zoo.GroupProcess().bind(data)
    at = {"noise_y": 0.3, "amplitude_y": 0.8, "w_y": 200.0, "b_y": 10.0}
    residual = rng.standard_normal((2, data.n_times)) * np.where(data.measured, 1.0, np.nan)
    weight = rng.standard_normal(residual.shape)
    by_residual, slopes = bound.gradient(residual, at, weight)
    total = dict.fromkeys(at, 0.0)
    for i, clock in enumerate((MISSING, FASTER)):
        alone = zoo.GroupProcess().bind(Data(clock, values[i], groups=["y"], period=1.0))
        seen = data.measured[i]
        one = residual[i, seen][None]
        for how in ("sequential", "leave-one-out"):
            terms = bound.terms(residual, at, how)[i]
            np.testing.assert_allclose(terms[seen], alone.terms(one, at, how)[0])
            assert not terms[~seen].any()
        np.testing.assert_allclose(bound.whiten(residual, at)[i, seen], alone.whiten(one, at)[0])
        own_slope, own_slopes = alone.gradient(one, at, weight[i, seen][None])
        np.testing.assert_allclose(by_residual[i, seen], own_slope[0])
        total = {name: total[name] + own_slopes[name] for name in total}
    assert slopes == pytest.approx(total)
    with pm.Model(coords={"series": data.labels, "time": data.times}) as model:
        bound.observe("y", np.zeros(data.values.shape), np.int8(1), at)
    assert model.compile_logp(vars=[model["y"]])({}) == pytest.approx(bound.log_density(data.values, at))


def test_errors_that_need_the_same_times_say_which_do_not() -> None:
    prior = zoo.LogUniform(1.0, 10.0)
    text = r"needs all series at the same times.*GroupNoise\(\), GroupProcess\(\) and Independent\(\) do not"
    with pytest.raises(ErrorModelError, match=text):
        zoo.GaussianProcess(prior, prior).bind(own([MISSING, FASTER]))


def observations(rows: dict[str, list[tuple[float, str]]]) -> str:
    lines = [f"{place},{time:.6f},{value}" for place, own in rows.items() for time, value in own]
    return "\n".join(["vessel,position,quantity,time_s,value", *lines]) + "\n"


def pressure(time: float) -> str:
    return f"{10 + 4 * np.exp(np.cos(2 * np.pi * (time / 0.11 - 0.2))):.4f}"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return Path(shutil.copytree(ROOT / "docs" / "example-study", tmp_path / "study"))


STEPS = [m * 0.005 for m in range(22)]
ROOT_PRESSURE, BRANCH_FLOW = "1,0,pressure_mmHg", "2,0.5,flow_ml_s"


def test_a_study_has_each_series_at_its_own_times_and_reads_back(folder: Path, tmp_path: Path) -> None:
    own = [(t, pressure(t)) for t in STEPS if t not in STEPS[6:9]]
    other = [(m * 0.0025, f"{0.1 + 0.001 * m:.4f}") for m in range(44)]
    (folder / "observations.csv").write_text(observations({ROOT_PRESSURE: own, BRANCH_FLOW: other}))
    study = zoo.load_study(folder)
    assert [one.n_samples for one in study.series] == [19, 44]
    np.testing.assert_allclose(study.time_s, np.arange(44) * 0.0025, atol=1e-12)
    seen = ~np.isnan(study.series[0].value)
    np.testing.assert_array_equal(study.series[0].value[seen], [float(x) for _, x in own])
    np.testing.assert_allclose(study.time_s[seen], [t for t, _ in own], atol=1e-12)
    zoo.save_study(study, tmp_path / "again")
    assert zoo.load_study(tmp_path / "again") == study
    with_empty = [(t, pressure(t) if t not in STEPS[6:9] else "") for t in STEPS]
    (folder / "observations.csv").write_text(observations({ROOT_PRESSURE: with_empty, BRANCH_FLOW: other}))
    assert zoo.load_study(folder).checksum == study.checksum


def test_rounded_times_with_gaps_are_put_on_the_grid(folder: Path) -> None:
    exact = np.delete(np.arange(32) * 0.11 / 32, [4, 5, 20])
    rows = [(round(t, 5), pressure(t)) for t in exact.tolist()]
    (folder / "observations.csv").write_text(observations({ROOT_PRESSURE: rows}))
    np.testing.assert_allclose(zoo.load_study(folder).time_s, exact, rtol=0, atol=1e-15)


def test_a_record_of_more_than_a_beat_or_of_few_samples_is_refused(folder: Path) -> None:
    late = [(t, pressure(t)) for t in [*STEPS[:10], *STEPS[12:], 0.113]]
    (folder / "observations.csv").write_text(observations({ROOT_PRESSURE: late}))
    with pytest.raises(zoo.StudyError, match=r"time_s = 0\.113: v1@0 .*: past period_s = 0\.11"):
        zoo.load_study(folder)
    few = [(t, pressure(t) if i > 6 else "") for i, t in enumerate(STEPS)]
    (folder / "observations.csv").write_text(observations({ROOT_PRESSURE: few}))
    with pytest.raises(zoo.StudyError, match="15 samples: too few for a beat; give at least 16"):
        zoo.load_study(folder)


def test_a_nominal_load_is_that_of_the_wave_whatever_samples_there_are(folder: Path) -> None:
    """Samples are left out where the wave is straight enough that lines take their place."""
    loads = []
    for gone in ((), (3, 9, 17)):
        rows = [(m * 0.11 / 110, pressure(m * 0.11 / 110)) for m in range(110) if m // 5 not in gone]
        (folder / "observations.csv").write_text(observations({ROOT_PRESSURE: rows}))
        network = zoo.Network.from_study(zoo.load_study(folder))
        loads.append(np.concatenate([network.R1, network.R2]))
    np.testing.assert_allclose(loads[1], loads[0], rtol=5e-3)


@pytest.mark.slow
@pytest.mark.needs_data
@pytest.mark.parametrize("name", ["observations", "gap"])
def test_records_as_they_are_measured(name: str, tmp_path: Path) -> None:
    """Each series has its own times; missing samples are left out of the likelihood."""
    case = SHARED / "cases" / "07-records-as-measured"
    if not case.is_dir():
        pytest.skip("needs the shared cases")
    study = Path(shutil.copytree(case, tmp_path / "study"))
    shutil.copy(case / f"{name}.csv", study / "observations.csv")
    loaded = replace(zoo.load_study(study), numerics={"accuracy_percent": 1.0})  # for the noise: slower
    counts = {"observations": [22, 44], "gap": [19]}[name]
    assert [one.n_samples for one in loaded.series] == counts
    found = zoo.diagnose(loaded, "B", effects=["viscoelastic-wall"], component_sizes=0.0, progress=False)
    assert found.sets.search.family.errors.size == sum(counts)
    found.plot()
    for model in (zoo.model_A(loaded), zoo.model_B(loaded)):
        assert np.isfinite(model.compile_logp()(model.initial_point()))
