"""Several experiments in one posterior: as the stacked linear model has it, which NumPy solves."""

from typing import Any

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

import zoo
from zoo.core.components import FreeFunction
from zoo.core.data import Data
from zoo.core.effects import EffectParameter, Location, Measure
from zoo.core.experiments import ExperimentError, Experiments
from zoo.core.forward import FunctionModel, Outputs
from zoo.core.parameters import as_parameters

CLOCKS = {"slow": np.arange(40) / 20.0, "fast": np.sort(np.random.default_rng(5).uniform(0.2, 2.0, 56))}
NOISE = {"slow": 0.05, "fast": 0.04}
PRIORS = {"level": zoo.Normal(1.0, 2.0), "slope": zoo.Normal(0.5, 1.0)}
SD, SCALE = {"level": 2.0, "slope": 1.0}, {"bend": 0.2, "wave": 0.2}


def columns(t: np.ndarray, drive: float) -> dict[str, np.ndarray]:
    """What each number does in an experiment with some input."""
    return {"level": 1.0 + 0.0 * t, "slope": drive * t, "bend": drive * t**2, "wave": drive * np.cos(9.0 * t)}


def driven(drive: float) -> Any:
    def line(c: Any, t: np.ndarray) -> np.ndarray:
        return np.asarray(sum(c.get(name, 0.0) * one for name, one in columns(t, drive).items()))

    return line


def adding(name: str) -> zoo.Effect:
    @zoo.effect(name, size=SCALE[name])
    def change(c, size):  # type: ignore[no-untyped-def]
        """Adds a term."""
        return {**c, name: size}

    return change


DRIVES = {"slow": 1.0, "fast": -0.7}
EFFECTS = [adding("bend"), adding("wave")]


def records(seed: int, second: float = -0.6, **added: float) -> dict[str, tuple[Any, Any, Any]]:
    rng, found = np.random.default_rng(seed), {}
    for (name, t), level in zip(CLOCKS.items(), (1.4, second), strict=True):
        y = driven(DRIVES[name])({"level": level, "slope": 0.8, **added}, t)
        found[name] = (t, y + NOISE[name] * rng.standard_normal(len(t)), driven(DRIVES[name]))
    return found


def diagnosed(given: Any, share: list[str], noise: Any = NOISE, **settings: Any) -> zoo.Diagnosis:
    known = {f"{name}/y0": sd for name, sd in noise.items()}
    errors = zoo.Uneven(known=known)
    return zoo.diagnose(given, PRIORS, EFFECTS, share=share, errors=errors, progress=False, **settings)


def stacked(given: Any, share: list[str], names: tuple[str, ...]) -> float:
    """Log density of all samples, whose parameters, sizes and white noise are normal."""
    y: list[np.ndarray] = []
    blocks: dict[str, list[np.ndarray]] = {}
    n = {name: len(one[0]) for name, one in given.items()}
    mean, sds = [], []
    for name, (t, values, _) in given.items():
        own = columns(t, DRIVES[name])
        y.append(values)
        mean.append(own["level"] * 1.0 + own["slope"] * 0.5)
        sds.append(np.full(n[name], NOISE[name]))
        for key, sd in (SD | SCALE).items():
            if key in SD or key in names:
                label = key if key in share or key in SCALE else f"{key}[{name}]"
                padded = [sd * own[key] if other == name else np.zeros(n[other]) for other in given]
                blocks.setdefault(label, []).append(np.concatenate(padded))
    A = np.stack([np.sum(parts, axis=0) for parts in blocks.values()], axis=1)
    K = A @ A.T + np.diag(np.concatenate(sds) ** 2)
    return float(multivariate_normal(np.concatenate(mean), K).logpdf(np.concatenate(y)))


def beside_noise(found: zoo.Diagnosis) -> dict[tuple[str, ...], float]:
    """Log evidence of each solved set beside white noise alone."""
    causes = found.sets.posterior.causes
    return {
        tuple(sorted(causes[i].name for i in which)): float(one.evidence.log_z[0])
        for which, one in found.sets.solved.items()
    }


@pytest.mark.parametrize("share", [[], ["slope"], ["level", "slope"]])
def test_evidence_and_probabilities_are_those_of_the_stacked_linear_model(share: list[str]) -> None:
    given = records(1, 1.4 if "level" in share else -0.6, bend=0.1, wave=0.04)
    found = diagnosed(given, share)
    got = beside_noise(found)
    exact = {which: stacked(given, share, which) for which in got}
    assert set(exact) == {(), ("bend",), ("wave",), ("bend", "wave")}
    for which in got:
        assert got[which] == pytest.approx(exact[which], abs=1e-3), which
    prior = {tuple(sorted(row.names)): row.log_prior for row in found.table}
    both = [np.array([log[which] + prior[which] for which in prior]) for log in (got, exact)]
    p = [np.exp(one - logsumexp(one)) for one in both]
    np.testing.assert_allclose(p[0], p[1], atol=1e-3)


def test_what_neither_shows_alone_both_show_together() -> None:
    """One size for both: the Bayes factor is that of the stack, and about the product of the two."""
    given = records(2, bend=0.08)
    together = diagnosed(given, [])
    alone = {
        name: zoo.diagnose(
            *one, PRIORS, EFFECTS, errors=zoo.Uneven(known={"y0": NOISE[name]}), progress=False
        )
        for name, one in given.items()
    }
    gained = {name: (z := beside_noise(one))["bend",] - z[()] for name, one in alone.items()}
    both = (z := beside_noise(together))["bend",] - z[()]
    assert both == pytest.approx(stacked(given, [], ("bend",)) - stacked(given, [], ()), abs=1e-3)
    assert both == pytest.approx(sum(gained.values()), abs=2.0)  # one prior of the size, not two
    p = {name: one.causes for name, one in (*alone.items(), ("both", together))}
    first = {name: next(c.probability for c in causes if c.name == "bend") for name, causes in p.items()}
    assert max(first["slow"], first["fast"]) < 0.4
    assert first["both"] > 0.8


def test_a_record_given_twice_with_half_the_precision_is_that_record() -> None:
    given = records(2, bend=0.1)["slow"]
    once = zoo.diagnose(*given, PRIORS, EFFECTS, errors=zoo.Cosines(known={"y0": 0.05}), progress=False)
    known = {f"{name}/y0": 0.05 * np.sqrt(2.0) for name in "ab"}
    twice = zoo.diagnose(
        [given, given], PRIORS, EFFECTS, share=["level", "slope"], progress=False,
        errors=zoo.Cosines(known={f"{i}/y0": sd for i, sd in enumerate(known.values(), 1)}),
    )  # fmt: skip
    np.testing.assert_array_equal(twice.data.times, given[0])
    one, two = beside_noise(once), beside_noise(twice)
    for which in one:
        assert two[which] - two[()] == pytest.approx(one[which] - one[()], abs=1e-4)
    base = [found.sets.solved[()] for found in (once, twice)]
    at = [one.point.u + one.evidence.mean[0] for one in base]
    np.testing.assert_allclose(at[0], at[1], rtol=1e-5)
    np.testing.assert_allclose(*(one.evidence.covariance[0] for one in base), rtol=1e-5)
    p = [next(c.probability for c in found.causes if c.name == "bend") for found in (once, twice)]
    assert p[1] == pytest.approx(p[0], abs=0.2)  # what nobody can name is not the same twice


def test_what_is_left_out_is_an_experiment_where_others_foretell_it() -> None:
    """Else a block of each; by the least squares of the others, which NumPy makes."""
    given = records(3, 1.4, bend=0.6)
    found = diagnosed(given, ["level", "slope"])
    assert found.cause == ["bend"]
    gap = found.file.gap
    assert gap.held_out == "each experiment in turn"
    sums = np.zeros(2)
    for name, other in (("slow", "fast"), ("fast", "slow")):
        for which, keys in enumerate((["level", "slope"], ["level", "slope", "bend"])):
            here, there = (
                {k: x / NOISE[n] for k, x in columns(CLOCKS[n], DRIVES[n]).items()} for n in (name, other)
            )
            sd, mean = {**SD, **SCALE}, {"level": 1.0, "slope": 0.5, "bend": 0.0}
            A = np.stack([there[k] for k in keys], axis=1)
            A = np.concatenate([A, np.diag([1 / sd[k] for k in keys])])
            y = np.concatenate([given[other][1] / NOISE[other], [mean[k] / sd[k] for k in keys]])
            x = np.linalg.lstsq(A, y, rcond=None)[0]
            left = given[name][1] - NOISE[name] * sum(x[i] * here[k] for i, k in enumerate(keys))
            sums[which] += np.sum(left**2 - NOISE[name] ** 2)
    n = sum(len(t) for t in CLOCKS.values())
    told = np.sqrt(np.maximum(sums / n, 0.0))
    np.testing.assert_allclose(
        [gap.held_out_before, gap.held_out_after], told, rtol=0.05
    )  # its refit ends where little is gained
    assert diagnosed(given, ["level"]).file.gap.held_out == "5 blocks of each record in turn"


def test_noise_is_one_for_all_unless_it_is_stated_for_each() -> None:
    """Six short records: not one quick discrepancy in the place of six noises of one size."""
    rng, given, rates = np.random.default_rng(0), {}, []

    def decay(c: Any, t: np.ndarray) -> np.ndarray:
        return c["a"] * np.exp(-c["k"] * t) + c.get("drift", 0.0) * t

    @zoo.effect("drift", size=0.1)
    def drift(c, size):  # type: ignore[no-untyped-def]
        return {**c, "drift": size}

    for i in range(6):
        t, k = np.linspace(0.0, 3.0, 30 + i), 0.8 * np.exp(0.3 * rng.standard_normal())
        rates.append(k)
        y = decay({"a": 2.0 + 0.1 * i, "k": k, "drift": 0.03}, t) + 0.05 * rng.standard_normal(len(t))
        given[f"s{i}"] = (t, y, decay)
    priors = {
        "median": zoo.LogNormal(1.0, 1.0),
        "variance": zoo.InverseGamma(2.0, 0.1),
        "k": zoo.LogPopulation("median", "variance"),
        "a": zoo.Normal(2.0, 1.0),
    }
    found = zoo.diagnose(given, priors, [drift], share=["median", "variance"], progress=False)
    assert found.cause == ["drift"]
    assert found.file.record["noise"]["y0"] == pytest.approx(0.05, rel=0.15)
    assert not [text for text in found.file.warnings if "changes no series" in text]
    told = found.file.base_parameters["over all sets"]
    for i, k in enumerate(rates):
        low, high = told[f"k[s{i}]"].interval
        assert low < k < high
    low, high = told["median"].interval
    assert low < np.exp(np.mean(np.log(rates))) < high
    with pytest.raises(ExperimentError, match=r"share = k: its prior depends on variance: share that too"):
        zoo.diagnose(given, priors, [drift], share=["median", "k"], progress=False)


def joined(share: list[str], **models: FunctionModel) -> Experiments:
    data = {
        name: Data(one.outputs.times, np.sin(3 * one.outputs.times)[None], labels=["y"])
        for name, one in models.items()
    }
    return Experiments(models, data, share)


def test_a_population_of_each_experiment_is_its_own() -> None:
    priors = {
        "m": zoo.LogNormal(1.0, 1.0),
        "v": zoo.InverseGamma(2.0, 0.1),
        "level": zoo.LogPopulation("m", "v"),
    }
    models = {name: model_of(name, {**PRIORS, **priors}) for name in CLOCKS}
    own = {p.name: p.prior.depends_on for p in joined(["m", "slope"], **models).parameters}
    assert own["level[slow]"] == ("m", "v[slow]")
    assert own["level[fast]"] == ("m", "v[fast]")


def model_of(name: str, priors: Any = PRIORS, finer: Any = None) -> FunctionModel:
    return FunctionModel(
        driven(DRIVES[name]), as_parameters(priors), Outputs(("y",), CLOCKS[name]), "line", finer=finer
    )


def test_each_experiment_is_solved_at_its_own_times_with_its_own_input() -> None:
    several = joined(["slope"], slow=model_of("slow"), fast=model_of("fast"))
    assert [p.name for p in several.parameters] == ["slope", "level[slow]", "level[fast]"]
    found = several.solve(several.configure(np.array([0.8, 1.0, 2.0])))
    for row, (name, level) in enumerate((("slow", 1.0), ("fast", 2.0))):
        own = driven(DRIVES[name])({"level": level, "slope": 0.8}, CLOCKS[name])
        np.testing.assert_allclose(several.data.samples(row, found), own, atol=1e-12)
    halves = Outputs((("fast", "y"),), np.array([0.25, 0.75]))
    d = several.records["fast"]
    at = d.times[0] + d.duration * (halves.times - 0.5 / d.n_times)
    own = driven(DRIVES["fast"])({"level": 2.0, "slope": 0.8}, at)
    np.testing.assert_allclose(several.solve(several.configure(np.array([0.8, 1.0, 2.0])), halves)[0], own)


def test_periods_that_differ_are_one_beat() -> None:
    clocks = {"slow": np.arange(32) / 32 * 0.9, "fast": 4.0 + np.arange(32) / 32 * 0.3}
    data = {
        name: Data(t, np.sin(2 * np.pi * (t - t[0]) / T)[None], period=T)
        for (name, t), T in zip(clocks.items(), (0.9, 0.3), strict=True)
    }
    models = {
        name: FunctionModel(driven(1.0), as_parameters(PRIORS), Outputs(("y0",), t))
        for name, t in clocks.items()
    }
    several = Experiments(models, data)
    assert several.data.period == 1.0
    assert several.data.even
    np.testing.assert_allclose(several.data.times, np.arange(32) / 32, atol=1e-12)


def test_an_experiment_of_which_nothing_changes_is_not_solved_again() -> None:
    calls = {"slow": 0, "fast": 0}

    def counting(name: str) -> Any:
        line = driven(DRIVES[name])

        def simulate(c: Any, t: Any) -> Any:
            calls[name] += 1
            return line(c, t)

        return simulate

    given = {name: (t, y, counting(name)) for name, (t, y, _) in records(1, bend=0.1).items()}
    found = diagnosed(given, [])
    solves = found.sets.search.fitting.solves
    assert sum(calls.values()) < 1.5 * solves  # of 2 solves


def test_half_the_steps_are_taken_in_each_or_in_none() -> None:
    theta = np.array([1.0, 0.8, 2.0, 0.8])
    several = joined([], slow=model_of("slow", finer=driven(5.0)), fast=model_of("fast", finer=driven(7.0)))
    finer = several.refined()
    assert finer is not None
    found = finer.solve(finer.configure(theta))
    for row, (name, drive) in enumerate((("slow", 5.0), ("fast", 7.0))):
        own = driven(drive)({"level": theta[2 * row], "slope": 0.8}, CLOCKS[name])
        np.testing.assert_allclose(several.data.samples(row, found), own)
    assert joined([], slow=model_of("slow", finer=driven(5.0)), fast=model_of("fast")).refined() is None


def test_an_effect_is_of_one_size_at_the_places_that_all_have_with_the_widest_prior() -> None:
    lengths = {"slow": 4.0, "fast": 1.0}
    places = {"slow": (Location(1), Location(2)), "fast": (Location(2), Location(3))}

    def named(model: Any) -> str:
        return "slow" if model.outputs.times[1] == CLOCKS["slow"][1] else "fast"

    late = EffectParameter(
        "late", "s", 0.1, -1.0, 1.0, (0.1,), measure=Measure("records", lambda model: lengths[named(model)])
    )

    @zoo.effect("late", parameters=[late], locations=lambda model: places[named(model)])
    def effect(c, values, location):  # type: ignore[no-untyped-def]
        return {**c, "level": c["level"] + values[0] * location.part}

    several = joined(["level", "slope"], slow=model_of("slow"), fast=model_of("fast"))
    made = several.effect(effect)
    assert made.locations(several) == (Location(2),)
    assert made.parameters[0].text == "normal(0, 0.4) in [-4, 4] s"
    assert made.apply is not None
    changed = made.apply(several.configure(np.array([1.0, 0.5])), (0.3,), Location(2))
    assert {name: float(c["level"]) for name, c in changed.items()} == pytest.approx(
        {"slow": 1.6, "fast": 1.6}
    )


def test_a_free_function_is_one_for_all_over_the_values_of_all() -> None:
    """Friction by speed, learned from a slow and from a fast body."""
    times = {"slow": np.arange(0.0, 4.0, 0.05), "fast": np.arange(0.0, 3.0, 0.04)}

    def body(first: float) -> Any:
        def slides(c: Any, t: np.ndarray) -> np.ndarray:
            v, series, step = first, [], t[1] - t[0]
            for _ in t:
                series.append(v)
                v = v - step * (c["b"] * v + float(c["friction"](v)))
            return np.array(series)

        return slides

    starts, rng = {"slow": 2.0, "fast": 5.0}, np.random.default_rng(3)
    truth = {"b": 0.3, "friction": lambda v: 0.1 * v * abs(v)}
    given = {
        name: (t, body(starts[name])(truth, t) + 0.01 * rng.standard_normal(len(t)), body(starts[name]))
        for name, t in times.items()
    }
    friction = zoo.free_function("friction", along="speed", size=1.0)
    priors = {"b": zoo.Normal(0.3, 0.05)}
    found = zoo.diagnose(given, priors, [friction], share=["b"], progress=False)
    [learned] = found.components[0].functions
    assert found.cause[0].startswith("friction")
    v, b = np.array(learned.values), found.file.base_parameters["leading set"]["b"]
    assert v[0] < min(one[1][-1] for one in given.values())  # where the slow body ends
    assert v[-1] > 5.0  # where the fast one begins
    seen = (v > 1.0) & (v < 5.0)
    both = b.mean * v + np.array(learned.mean)
    np.testing.assert_allclose(both[seen], 0.3 * v[seen] + 0.1 * v[seen] ** 2, atol=0.15)


def test_a_function_of_a_period_is_the_same_at_each_part_of_it() -> None:
    def own(model: Any, theta: Any, data: Data) -> list[FreeFunction]:
        T, n = (2.0, 4) if len(data.times) == 40 else (0.5, 8)
        at = np.arange(n) / n * T
        return [
            FreeFunction("f", "part", at, 1.0, lambda c, v: {**c, "f": v}, period=T, lengths=(T,)),
        ]

    several = joined([], slow=model_of("slow"), fast=model_of("fast"))
    theta = np.ones(4)
    [one] = several.functions(own, theta)
    values = np.array([1.0, 2.0, 3.0, 4.0])
    changed = one.apply(several.configure(theta), values)
    between = np.array([1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 2.5])
    few, many = sorted((changed[name]["f"] for name in CLOCKS), key=len)
    np.testing.assert_allclose(few, values)
    np.testing.assert_allclose(many, between)


@pytest.mark.parametrize(
    ("given", "settings", "told"),
    [
        ({"slow": records(1)["slow"]}, {}, "1 experiments: give at least two"),
        (
            {"a/b": records(1)["slow"], "c": records(1)["fast"]},
            {},
            "experiment 'a/b': a name without a slash",
        ),
        (records(1), {"share": ["slpe"]}, "share = slpe: experiment slow: .*slope"),
        (records(1), {"share": "slope"}, r"share = 'slope': give a list, such as \['slope'\]"),
        ({"a": records(1)["slow"][1:], "b": records(1)["fast"]}, {}, "give a dict of records"),
        ([records(1)["slow"][:2], records(1)["fast"]], {}, "give a dict of records"),
    ],
)
def test_what_cannot_be_taken_as_one_is_told(given: Any, settings: Any, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        zoo.diagnose(given, PRIORS, EFFECTS, progress=False, **settings)


def test_experiments_are_lists_with_labels_and_periods_as_records_alone_have_them() -> None:
    t = np.sort(np.random.default_rng(0).uniform(0.0, 2.0 * np.pi, 30))
    record = [t, 1.0 + np.cos(t), lambda c, t: c["level"] + np.cos(t)]
    settings: Any = {"labels": ["out/in"], "period": 2.0 * np.pi, "progress": False, "share": ["level"]}
    found = zoo.diagnose([record, record], {"level": zoo.Normal(0, 5)}, noise={"out/in": 0.1}, **settings)
    assert found.data.labels == ("1/out/in", "2/out/in")
    assert found.data.period == pytest.approx(2.0 * np.pi)
    assert found.file.record["noise"] == pytest.approx({"out/in": 0.1}, rel=0.5)


def test_shared_parameters_are_of_one_prior() -> None:
    other = model_of("fast", {**PRIORS, "slope": zoo.Normal(0.5, 3.0)})
    with pytest.raises(
        ExperimentError, match=r"share = slope: it is normal\(0.5, 1\) in slow and normal\(0.5, 3\)"
    ):
        joined(["slope"], slow=model_of("slow"), fast=other)
    assert len(joined(["level"], slow=model_of("slow"), fast=other).parameters) == 3


def test_all_experiments_repeat_themselves_or_none() -> None:
    periods = {"slow": 2.0, "fast": None}
    data = {name: Data(CLOCKS[name], np.sin(CLOCKS[name])[None], period=T) for name, T in periods.items()}
    with pytest.raises(
        ExperimentError, match=r"period of slow 2.0, fast None: give all experiments one, or none"
    ):
        Experiments({name: model_of(name) for name in CLOCKS}, data)
