"""Other tools on nature's records: their error where nothing was fitted, and what they say of a cause.

python -m benchmarks.nature.other_tools [--tools NAME ...] [--cases NAME ...]

runs these, keeps what came out in results.json and prints the tables of docs/nature.md. Each tool gets a
record, its base simulator with priors, and the inputs that a discrepancy may depend on, and computes the
record that is held out. Where an initial state or a load is another in that record (`refit`), the base's
parameters, and only they, are fitted to it again, as zoo does there. requirements.txt has what zoo does not
need.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from benchmarks.nature import CASES, data_file, durance, falling_balls, pig_aorta
from benchmarks.nature.scoring import Array
from examples import tanks as two_tanks
from scipy.optimize import least_squares
from scipy.stats import norm

from zoo.core.diagnosis import Diagnosis

SEED = 0
STEP, FARTHEST = 1e-3, 6.0
"""Of a parameter's derivative, and how far from its prior's median a fit may go, in standard deviations."""


@dataclass(frozen=True, eq=False)
class Series:
    """Times and measured series (n,), their simulator, and inputs (n, d) from the series that it computes."""

    times: Array
    measured: Array
    simulate: Callable[[Mapping[str, Any], Array], Array]
    inputs: Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class Record:
    """A record that is fitted, one that is not, and what is known of both."""

    name: str
    unit: str
    fitted: Series
    held_out: Series
    priors: Mapping[str, Any]
    inputs: tuple[str, ...]
    forecast: Array
    """Of the held-out series without a simulator: the fitted one's mean, or for a river its climatology."""
    refit: bool
    by_zoo: Callable[[], Array]
    """The held-out series with the causes that zoo finds."""

    def parameters(self, u: Array) -> dict[str, float]:
        """Parameters by name at standard normal quantiles (n_parameters,) of their priors."""
        pairs = zip(self.priors.items(), norm.cdf(u), strict=True)
        return {name: float(one.prior.quantile(p)) for (name, one), p in pairs}

    def compute(self, part: Series, u: Array) -> Array:
        """The base's series (n,)."""
        return part.simulate(self.parameters(u), part.times)

    def fit(self, part: Series, added: Array | float = 0.0, first: Array | None = None) -> Array:
        """Quantiles (n_parameters,) of the base's most probable parameters beside what is added to it."""
        u = np.zeros(len(self.priors)) if first is None else first

        def differ(u: Array, size: float) -> Array:
            return np.append((part.measured - added - self.compute(part, u)) / size, u)

        for _ in range(3):  # the size of the errors is that of what is left
            size = rms(part.measured - added - self.compute(part, u))
            slopes = lambda u, size: central(lambda v: differ(v, size), u).T  # noqa: E731
            u = least_squares(differ, u, slopes, bounds=(-FARTHEST, FARTHEST), args=(size,)).x
        return u

    def predict(self, u: Array, correction: Callable[[Array], Array]) -> Array:
        """The held-out series (n,): the base's, and the correction of its series where it is not corrected.

        Its parameters are u, those of the fitted record, or, where the record asks for it, fitted again.
        """
        part, alone = self.held_out, self.base
        added = correction(self.compute(part, self.fit(part, first=alone) if self.refit else alone))
        return added + self.compute(part, self.fit(part, added, u) if self.refit else u)

    @cached_property
    def base(self) -> Array:
        """Quantiles of the base's parameters, fitted alone."""
        return self.fit(self.fitted)


@dataclass(frozen=True)
class Answer:
    """What a tool says of a cause, and the held-out series (n,) as it computes it."""

    says: str
    held_out: Array


def central(function: Callable[[Array], Array], u: Array) -> Array:
    """Derivatives (n_parameters, ...) by central differences."""
    return np.array([(function(u + h) - function(u - h)) / (2.0 * STEP) for h in STEP * np.eye(len(u))])


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def balls() -> Iterator[Record]:
    """The balls of which the cause is known; the second drop of each is held out."""
    of, dropped = falling_balls, falling_balls.read_drops(data_file("falling-balls"))
    for ball in CASES["falling-balls"]["known"]:
        first, second = dropped[ball]
        parts = [Series(t, y, of.fall, lambda s, t=t: np.gradient(s, t)[:, None]) for t, y in (first, second)]
        mean = np.full(len(second[1]), first[1].mean())
        diagnosed = lambda pair=(first, second): with_learned(of.diagnose_ball(*pair))  # noqa: E731
        yield Record(ball, "m", *parts, of.PRIORS, ("speed",), mean, True, diagnosed)


def river() -> Iterator[Record]:
    """The Durance; the second half of the years is held out."""
    here = durance.Catchment.read(data_file("durance").parent)
    names = ("precipitation", "temperature", "evapotranspiration", "runoff")
    columns = ["precipitation_mm", "temperature_degC", "potential_evapotranspiration_mm"]
    weather = here.table[columns].rolling(durance.DAYS).mean().to_numpy()
    parts = []
    for times, runoff in (
        here.series(durance.FIRST, durance.HELD_OUT),
        here.series(durance.HELD_OUT, durance.END),
    ):
        last = weather[np.rint(times + 0.5 * durance.DAYS).astype(int) - 1]
        parts.append(Series(times, runoff, here.simulator(), lambda s, w=last: np.column_stack([w, s])))
    forecast = durance.climatology(here, parts[1].times)
    diagnosed = lambda: with_learned(durance.diagnose_river(here))  # noqa: E731
    yield Record("Durance", "mm/d", *parts, durance.PRIORS, names, forecast, True, diagnosed)


def pig() -> Iterator[Record]:
    """A pig's aorta; record 2 is held out."""
    of, folder, parts = pig_aorta, data_file("pig-aorta").parent, []
    for number in (1, 2):
        period, times, pressure, flow = of.mean_beat(folder, number)
        simulate = of.windkessel(period, flow)
        parts.append(Series(times, pressure, simulate, lambda s, q=flow: np.column_stack([q, s])))
    mean = np.full(len(parts[1].measured), parts[0].measured.mean())
    diagnosed = lambda: with_learned(of.diagnose_pig(folder))  # noqa: E731
    yield Record("pig's aorta", "mmHg", *parts, of.PRIORS, ("flow", "pressure"), mean, True, diagnosed)


def tanks() -> Iterator[Record]:
    """Two tanks; the test record is held out, with nothing fitted to it."""
    record, parts = two_tanks.read(data_file("cascaded-tanks")), []
    for which in ("Est", "Val"):
        u, y = record[f"u{which}"], record[f"y{which}"]
        model = two_tanks.tanks(u)
        parts.append(
            Series(two_tanks.times(len(y)), y, model.function, lambda s, u=u: np.column_stack([u, s]))
        )
    priors = {one.name: one for one in model.parameters}
    mean = np.full(len(y), parts[0].measured.mean())

    def diagnosed() -> Array:
        return list(two_tanks.predictions(two_tanks.diagnosed(record), record["uVal"]).values())[-1]

    yield Record("two tanks", "V", *parts, priors, ("voltage", "level"), mean, False, diagnosed)


def with_learned(found: Diagnosis) -> Array:
    """The first held-out series (n,) with the set of causes that the first table tells."""
    from benchmarks.nature.__main__ import learned

    return np.asarray(found.states[0].computed[learned(found)][0])


RECORDS = {"falling-balls": balls, "durance": river, "pig-aorta": pig, "cascaded-tanks": tanks}
