"""Daily runoff of the Durance at Embrun: two linear reservoirs as base, and twelve rivals.

Water is in mm over the catchment, time in days since 1999-01-01. Prior sizes are from hydrology's textbooks
and from what gauges can be off by, and were chosen before any diagnosis. Series are means over five days.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from benchmarks.nature import Parameters, rival
from numba import njit  # type: ignore[import-untyped]
from numpy.typing import NDArray

import zoo
from zoo.core.diagnosis import Diagnosis

Array = NDArray[np.float64]

DAYS = 5  # of a mean
LAPSE = 0.0065  # K/m
BANDS = (10, 30, 50, 70, 90)  # per cent of the area below the middle of each
FIRST, HELD_OUT, END = "1999-09-01", "2004-09-01", "2009-06-25"  # hydrological years; before: warm-up


@dataclass(frozen=True, eq=False)
class Catchment:
    """Weather and runoff by day, snow cover of five bands from satellites, and the bands' elevations."""

    table: pd.DataFrame
    above_m: Array

    @classmethod
    def read(cls, folder: Path) -> Catchment:
        """From the files of the folder `durance`."""
        table = pd.read_csv(folder / "daily.csv", parse_dates=["date"]).set_index("date")
        height = pd.read_csv(folder / "hypsometry.csv").set_index("percent_of_area_below")["elevation_m"]
        return cls(table, height.loc[list(BANDS)].to_numpy() - height.loc[50])

    @property
    def cover(self) -> pd.DataFrame:
        """Part of each band that satellites saw under snow; no fit uses it."""
        return self.table[[f"snow_cover_band{i + 1}" for i in range(len(BANDS))]]

    def series(self, first: str, last: str) -> tuple[Array, Array]:
        """Middle of each five days, and mean runoff (mm/day) in them."""
        runoff = self.table.loc[first:last, "runoff_mm"].to_numpy()  # type: ignore[misc]
        n = len(runoff) // DAYS
        start = (pd.Timestamp(first) - self.table.index[0]).days
        return start + DAYS * (np.arange(n) + 0.5), runoff[: n * DAYS].reshape(n, DAYS).mean(axis=1)

    def daily(self, c: Parameters) -> tuple[Array, Array]:
        """Runoff (n_days,), and snow (n_days, n_bands) in mm of water."""
        rain, warm, evaporation = (
            self.table[name].to_numpy(float)
            for name in ("precipitation_mm", "temperature_degC", "potential_evapotranspiration_mm")
        )
        year = 2.0 * np.pi * self.table.index.day_of_year.to_numpy() / 365.25
        season = np.cos(year - 2.0 * np.pi * c.get("wet_day", 15.0) / 365.25)
        rain = rain * (1.0 + c.get("rain", 0.0)) * np.maximum(1.0 + c.get("season", 0.0) * season, 0.0)
        rain = np.maximum(rain - c.get("interception", 0.0), 0.0)
        temperatures = warm[:, None] - LAPSE * self.above_m
        liquid, packs = _snow(rain, temperatures, c.get("snow", 0.0), c.get("melt", 4.0))
        evaporation = evaporation * (1.0 + c.get("evaporation", 0.0))
        runoff = _reservoirs(
            liquid, evaporation, warm, c["fast"], c["slow"], c["share"], c.get("third", 0.0),
            c.get("third_days", 1000.0), c.get("capacity", 0.0), c.get("frozen", 0.0),
        )  # fmt: skip
        runoff = runoff * (1.0 - c.get("leak", 0.0))
        runoff = runoff - c.get("abstraction", 0.0) * np.isin(self.table.index.month, (6, 7, 8, 9))
        if c.get("travel", 0.0) > 0.0:
            days = np.arange(len(runoff), dtype=float)
            runoff = np.interp(days - c["travel"], days, runoff)
        return runoff + c.get("offset", 0.0), packs

    def simulator(self) -> Callable[[Parameters, Array], Array]:
        """Mean runoff in the five days around each time."""

        def simulate(c: Parameters, times: Array) -> Array:
            total = np.concatenate([[0.0], np.cumsum(self.daily(c)[0])])
            at = np.rint(np.asarray(times) - 0.5 * DAYS).astype(int)
            return np.asarray((total[at + DAYS] - total[at]) / DAYS)

        return simulate


@njit(cache=False)  # type: ignore[misc]
def _snow(rain: Array, temperatures: Array, part: float, melt: float) -> tuple[Array, Array]:
    """Water that reaches the ground; a part of what falls below 0 degC is stored and melts by degree-days."""
    n, bands = temperatures.shape
    liquid, packs = np.zeros(n), np.zeros((n, bands))
    for b in range(bands):
        pack = 0.0
        for t in range(n):
            fallen = part * rain[t] if temperatures[t, b] < 0.0 else 0.0
            pack += fallen
            melted = min(pack, melt * max(temperatures[t, b], 0.0))
            pack -= melted
            packs[t, b] = pack
            liquid[t] += (rain[t] - fallen + melted) / bands
    return liquid, packs


@njit(cache=False)  # type: ignore[misc]
def _reservoirs(
    liquid: Array, evaporation: Array, warm: Array, fast: float, slow: float, share: float, third: float,
    third_days: float, capacity: float, frozen: float,
) -> Array:  # fmt: skip
    """Outflow of linear reservoirs; negative where evapotranspiration takes more than there is."""
    n = len(liquid)
    found, soil = np.empty(n), 0.0
    mean = max(liquid.mean() - evaporation.mean(), 0.0)
    a, b, c = share * mean * fast, (1.0 - share) * (1.0 - third) * mean * slow, 0.0
    c = (1.0 - share) * third * mean * third_days
    for t in range(n):
        excess = liquid[t] - evaporation[t]
        if capacity > 0.0:
            soil += excess
            excess = max(soil - capacity, 0.0)
            soil = min(max(soil, 0.0), capacity)
        to_fast = share + (1.0 - share) * (frozen if warm[t] < 0.0 else 0.0)
        a += to_fast * excess
        b += (1.0 - to_fast) * (1.0 - third) * excess
        c += (1.0 - to_fast) * third * excess
        out = (
            a * (1.0 - np.exp(-1.0 / fast)),
            b * (1.0 - np.exp(-1.0 / slow)),
            c * (1.0 - np.exp(-1.0 / third_days)),
        )
        a, b, c = a - out[0], b - out[1], c - out[2]
        found[t] = out[0] + out[1] + out[2]
    return found


def _with_shape(name: str, keys: tuple[str, str], first: Any, second: Any) -> Any:
    @zoo.effect(name, parameters=[first, second])
    def change(c: Parameters, values: tuple[float, ...], at: Any) -> dict[str, Any]:
        return {**c, keys[0]: values[0], keys[1]: values[1]}

    return change


P = zoo.EffectParameter
RIVALS = [
    _with_shape(
        "snow", ("snow", "melt"),
        P("part", "1", 0.5, 0.0, 1.0, (0.5, 1.0)),
        P("melt", "mm/(K d)", 1.5, 0.5, 10.0, (), centre=4.0, zero_is_base=False),
    ),
    _with_shape(
        "third-reservoir", ("third", "third_days"),
        P("part", "1", 0.3, 0.0, 1.0, (0.3,)),
        P("time", "d", 500.0, 300.0, 3000.0, (), centre=1000.0, zero_is_base=False),
    ),
    rival("rainfall-gain", "rain", "1", 0.2, -0.9),
    _with_shape(
        "rainfall-gain-by-season", ("season", "wet_day"),
        P("gain", "1", 0.3, -1.0, 1.0, (0.3, -0.3)),
        P("day", "d", 60.0, -165.0, 195.0, (), centre=15.0, zero_is_base=False),
    ),
    rival("evapotranspiration-gain", "evaporation", "1", 0.3, -1.0),
    rival("soil-threshold", "capacity", "mm", 50.0, 0.0),
    rival("interception", "interception", "mm/d", 1.0, 0.0),
    rival("leak-to-depth", "leak", "1", 0.2, 0.0, 1.0),
    rival("travel-time", "travel", "d", 2.0, 0.0),
    rival("frozen-soil", "frozen", "1", 0.5, 0.0, 1.0),
    rival("summer-abstraction", "abstraction", "mm/d", 0.3, 0.0),
    rival("gauge-offset", "offset", "mm/d", 0.2),
]  # fmt: skip
PRIORS = {
    "fast": zoo.Parameter("fast", zoo.LogNormal(10.0, 1.0), "d"),
    "slow": zoo.Parameter("slow", zoo.LogNormal(100.0, 1.0), "d"),
    "share": zoo.Parameter("share", zoo.Uniform(0.0, 1.0), "1"),
}


def diagnose_river(catchment: Catchment) -> Diagnosis:
    """The first years' runoff; what was learned is tried on the years after."""
    simulate = catchment.simulator()
    later = (*catchment.series(HELD_OUT, END), simulate)
    return zoo.diagnose(
        *catchment.series(FIRST, HELD_OUT), simulate, PRIORS, RIVALS, labels=["runoff"], units=["mm/d"],
        held_out={"second half": later},
    )  # fmt: skip


def efficiency(measured: Array, computed: Array) -> float:
    """Nash and Sutcliffe's: 1 less the squares that are left over those around the mean."""
    return float(1.0 - np.sum((measured - computed) ** 2) / np.sum((measured - measured.mean()) ** 2))


def climatology(catchment: Catchment, at: Array) -> Array:
    """Mean of the first years' runoff by day of the year, 31 days smoothed, at days (n,)."""
    first = catchment.table.loc[FIRST:HELD_OUT, "runoff_mm"]  # type: ignore[misc]
    by_day = first.groupby(first.index.day_of_year).mean().reindex(range(1, 367)).interpolate()  # type: ignore[attr-defined]
    round_ = (
        pd.concat([by_day.iloc[-40:], by_day, by_day.iloc[:40]]).rolling(31, center=True).mean().iloc[40:-40]
    )
    days = (catchment.table.index[0] + pd.to_timedelta(np.asarray(at), unit="D")).day_of_year
    return np.asarray(round_.to_numpy()[np.asarray(days) - 1])


def tell_held_out(catchment: Catchment, found: Diagnosis) -> None:
    """Print the efficiency of base and leading set in both halves, and their snow beside the satellites'."""
    sets, simulate = found.sets, catchment.simulator()
    halves = [catchment.series(FIRST, HELD_OUT), catchment.series(HELD_OUT, END)]
    print("| computed by | efficiency, first half (fitted) | second half |\n|---|---|---|")
    rows: dict[str, Callable[[Array], Array]] = {
        "climatology of the first half": lambda t: climatology(catchment, t)
    }
    learned: dict[str, Any] = {}
    for name, which in (("two reservoirs", ()), ("with " + sets.name(sets.leader), sets.leader)):
        one = sets.solved[which]
        learned = one.forward.model.configure(one.forward.theta(one.point.u))
        rows[name] = lambda t, c=dict(learned): simulate(c, t)
    for name, computed in rows.items():
        print(f"| {name} | " + " | ".join(f"{efficiency(q, computed(t)):.2f}" for t, q in halves) + " |")
    if learned.get("snow", 0.0) == 0.0:
        print("no snow was learned")
        return
    packs = pd.DataFrame(
        catchment.daily(learned)[1], index=catchment.table.index, columns=catchment.cover.columns
    )
    print("| band | correlation of departures | melt-out: years | mean error, d | by the calendar, d |")
    print("|---|---|---|---|---|")
    for name, seen in catchment.cover.items():
        both = pd.DataFrame({"seen": seen, "pack": np.minimum(packs[name], FULL) / FULL}).dropna()
        away = both - both.groupby(both.index.day_of_year).transform("mean")
        ends = pd.DataFrame({k: melt_out(both[k]) for k in both}).dropna()
        error = (ends["pack"] - ends["seen"]).abs().mean()
        others = (ends["seen"].sum() - ends["seen"]) / (len(ends) - 1)  # the mean of all other years
        corr, calendar = away["seen"].corr(away["pack"]), (ends["seen"] - others).abs().mean()
        band = name.removeprefix("snow_cover_")
        print(f"| {band} | {corr:.2f} | {len(ends)} | {error:.0f} | {calendar:.0f} |")


FULL = 20.0
"""Snow in mm of water from which on all of a band is taken to be covered."""


def melt_out(cover: pd.Series) -> pd.Series:
    """Day of the year by year on which less than half of a band is covered for the rest of the summer."""
    found = {}
    for year, part in cover.groupby(cover.index.year):
        spring = part[(part.index.day_of_year > 60) & (part.index.day_of_year < 240)]
        covered = spring[spring >= 0.5]
        if len(covered) and covered.index[-1].day_of_year < 235:
            found[year] = covered.index[-1].day_of_year
    return pd.Series(found, dtype=float)
