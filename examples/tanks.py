"""Diagnose the cascaded tanks: what the simple equations of a measured experiment lack.

    python examples/tanks.py [--figure FILE]

diagnoses the estimation record, and predicts the test record with and without what was found.

A pump fills the upper tank, which runs out into the lower one, which runs out into the reservoir:

    dx1/dt = -k1 sqrt(x1) + k4 u,    dx2/dt = k3 (sqrt(x1) - sqrt(x2)),    y = x2,

u the pump's voltage, y the measured level. The benchmark writes k2 sqrt(x1) for the lower tank's inflow; the
upper level is not measured, so its unit is free, and k2 = k3 fixes it without loss: x1 is stated as the level
that the lower tank has in a steady state.

References
----------
Schoukens, Mattsson, Wigren and Noël 2016, doi 10.4121/12960104.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from zoo import (
    Cosines,
    Data,
    Diagnosis,
    Effect,
    EffectParameter,
    FunctionModel,
    Location,
    LogUniform,
    Outputs,
    Parameter,
    Uniform,
    diagnose,
    effect,
    fetch_file,
    with_effects,
)

Array = NDArray[np.float64]

STEP_S = 4.0
SUBSTEPS = 2
"""Runge-Kutta steps in a sample."""
MIDDLE_V = 5.0
"""Half the sensor's range: where the laws of other exponents equal the simple ones."""


def read(path: Any) -> dict[str, Array]:
    """Columns uEst, uVal, yEst, yVal (1024,) of dataBenchmark.csv, V."""
    table = np.genfromtxt(path, delimiter=",", names=True, deletechars='"')
    return {name: table[name] for name in ("uEst", "uVal", "yEst", "yVal")}


# ---------------------------------------------------------------------------------------------------
# The simulator. Its configuration holds the parameters by name; effects add what the simple equations lack.


def levels(c: dict[str, Any], inflow: Array) -> Array:
    """Level of the lower tank (n,) at the start of each sample, by the classical Runge-Kutta scheme.

    Parameters
    ----------
    c : dict
        Parameters, and whatever effects have added.
    inflow : array (n,)
        k4 u, V/s, held over each sample.
    """
    k1, k3, h = float(c["k1"]), float(c["k3"]), STEP_S / SUBSTEPS
    p1, p2 = 0.5 + c.get("upper exponent", 0.0), 0.5 + c.get("lower exponent", 0.0)
    c1, c2 = MIDDLE_V ** (0.5 - p1), MIDDLE_V ** (0.5 - p2)
    crack1, height1 = (float(value) for value in c.get("upper crack", (0.0, 0.0)))
    crack2, height2 = (float(value) for value in c.get("lower crack", (0.0, 0.0)))
    rim1, share, rim2 = c.get("upper rim", math.inf), c.get("share", 0.0), c.get("lower rim", math.inf)
    back, sqrt = c.get("back pressure", 0.0), math.sqrt
    simple1 = p1 == 0.5 and not crack1 and not back
    simple2 = p2 == 0.5 and not crack2

    def upper(x: float) -> tuple[float, float]:  # law of the outlet; all that depends on the level
        x = max(x, 0.0)
        law = float(c1 * x**p1)
        return law, k1 * law + crack1 * sqrt(max(x - height1, 0.0)) + q * min(back * x, 1.0)

    def lower(x: float) -> float:
        x = max(x, 0.0)
        return k * float(c2 * x**p2) + crack2 * sqrt(max(x - height2, 0.0))

    x1, x2 = float(c["x1(0)"]), float(c["x2(0)"])
    factors = 1.0 + c.get("outlet drift", 0.0) * (np.arange(len(inflow)) / len(inflow) - 0.5)
    found = []
    for q, factor in zip(inflow.tolist(), factors.tolist(), strict=True):
        found.append(x2)
        k: float = k3 * factor
        for _ in range(SUBSTEPS):
            if simple1:
                ga = k1 * (fa := sqrt(x1))
                gb = k1 * (fb := sqrt(max(x1 + 0.5 * h * (q - ga), 0.0)))
                gc = k1 * (fc := sqrt(max(x1 + 0.5 * h * (q - gb), 0.0)))
                gd = k1 * (fd := sqrt(max(x1 + h * (q - gc), 0.0)))
            else:
                fa, ga = upper(x1)
                fb, gb = upper(x1 + 0.5 * h * (q - ga))
                fc, gc = upper(x1 + 0.5 * h * (q - gb))
                fd, gd = upper(x1 + h * (q - gc))
            x1 = max(x1 + h * (q - (ga + 2.0 * gb + 2.0 * gc + gd) / 6.0), 0.0)
            if x1 > rim1:  # in the lower tank's volts, water of the upper one counts k3/k1
                falling = share * (x1 - rim1) / (h * k1)
                fa, fb, fc, fd = fa + falling, fb + falling, fc + falling, fd + falling
                x1 = rim1
            if simple2:
                da = k3 * fa - k * sqrt(x2)
                db = k3 * fb - k * sqrt(max(x2 + 0.5 * h * da, 0.0))
                dc = k3 * fc - k * sqrt(max(x2 + 0.5 * h * db, 0.0))
                dd = k3 * fd - k * sqrt(max(x2 + h * dc, 0.0))
            else:
                da = k3 * fa - lower(x2)
                db = k3 * fb - lower(x2 + 0.5 * h * da)
                dc = k3 * fc - lower(x2 + 0.5 * h * db)
                dd = k3 * fd - lower(x2 + h * dc)
            x2 = min(max(x2 + h * (da + 2.0 * db + 2.0 * dc + dd) / 6.0, 0.0), rim2)
    return np.asarray(found)


def lagged(series: Array, time_constant_s: float) -> Array:
    """A series that is held over each sample, at the samples' ends behind a first-order lag."""
    a = math.exp(-STEP_S / max(time_constant_s, 1e-3))
    return np.asarray(lfilter([1.0 - a], [1.0, -a], series, zi=[a * series[0]])[0])


def tanks(u: Array, name: str = "tanks") -> FunctionModel:
    """The simple equations as a forward model, driven by the pump's voltage u (n,).

    Priors, each from what the apparatus is and not from the record:

    - k = (a/A) sqrt(2 g s): outlets of some millimetres (a) in tanks of some centimetres (A), a/A of 0.001 to
      0.005; s of 10 V for some 0.3 m: k is about 0.05 sqrt(V)/s, known to a factor of ten either way.
    - k4: a pump whose middle voltage of 5 V holds the middle level of 5 V has k4 = 0.05 sqrt(5)/5 = 0.02 1/s;
      to a factor of ten either way too.
    - Initial levels lie between empty and full: 10 V for the measured tank; 15 V for the upper one, whose
      section may be another.
    """

    def simulate(c: dict[str, Any], at: Array) -> Array:
        drive = u
        for change in c.get("pump", ()):
            drive = change(drive)
        level = levels(c, float(c["k4"]) * drive)
        for change in c.get("sensor", ()):
            level = change(level)
        return level

    parameters = (
        Parameter("k1", LogUniform(0.005, 0.5), "sqrt(V)/s", log=True),
        Parameter("k3", LogUniform(0.005, 0.5), "sqrt(V)/s", log=True),
        Parameter("k4", LogUniform(0.002, 0.2), "1/s", log=True),
        Parameter("x1(0)", Uniform(0.0, 15.0), "V", start=5.0),
        Parameter("x2(0)", Uniform(0.0, 10.0), "V", start=5.0),
    )
    return FunctionModel(simulate, parameters, Outputs(("level",), times(len(u))), name)


def times(n: int) -> Array:
    """Times (n,) of the samples, s."""
    return STEP_S * np.arange(n, dtype=np.float64)


def data(y: Array, name: str = "cascaded tanks") -> Data:
    """A record of the lower tank's level y (n,), V."""
    return Data(times(len(y)), y, labels=("level",), units=("V",), name=name)


# ---------------------------------------------------------------------------------------------------
# What may be missing. Scales and bounds come from the apparatus (pumps, tanks, sensors); none was tuned.

LEVEL = 0.1
LEVEL_WHY = "tank and sensor end at about 10 V, so 1/level is about 0.1 1/V; the sections may differ"


def pump(c: dict[str, Any], change: Any) -> dict[str, Any]:
    """The configuration with one more change of the voltage."""
    return {**c, "pump": (*c.get("pump", ()), change)}


def sensor(c: dict[str, Any], change: Any) -> dict[str, Any]:
    """The configuration with one more change of the measured level."""
    return {**c, "sensor": (*c.get("sensor", ()), change)}


@effect(
    "upper-overflow",
    parameters=[
        EffectParameter("1/level", "1/V", LEVEL, 0.0, 0.5, (0.1, 0.15, 0.2), LEVEL_WHY),
        EffectParameter(
            "share", "1", 0.3, 0.0, 1.0, (0.5,), "none or all may fall into the tank below",
            centre=0.5, zero_is_base=False,
        ),
    ],
    equation="x1 <= L1; of what exceeds it, a share falls into the lower tank",
)  # fmt: skip
def upper_overflow(c: dict[str, Any], values: tuple[float, ...], at: Location) -> dict[str, Any]:
    """The upper tank overflows, and a share of that water falls into the lower tank."""
    return {**c, "upper rim": 1.0 / values[0] if values[0] > 0 else math.inf, "share": values[1]}


@effect(
    "lower-overflow",
    parameters=[EffectParameter("1/level", "1/V", LEVEL, 0.0, 0.5, (0.1, 0.15), LEVEL_WHY)],
    equation="x2 <= L2",
)
def lower_overflow(c: dict[str, Any], values: tuple[float, ...], at: Location) -> dict[str, Any]:
    """The lower tank overflows into the reservoir."""
    return {**c, "lower rim": 1.0 / values[0] if values[0] > 0 else math.inf}


@effect(
    "sensor-saturation",
    parameters=[EffectParameter("1/level", "1/V", LEVEL, 0.0, 0.5, (0.1, 0.15), LEVEL_WHY)],
    equation="y = min(x2, L)",
)
def sensor_saturation(c: dict[str, Any], values: tuple[float, ...], at: Location) -> dict[str, Any]:
    """The level sensor reads no more than a largest level, whatever the tank holds."""
    s = values[0]
    return sensor(c, lambda y: np.minimum(y, 1.0 / s) if s > 0 else y)


EXPONENT = EffectParameter(
    "exponent", "1", 0.2, -0.4, 0.5, (0.1, -0.1),
    "an orifice has the exponent 1/2, a narrow pipe up to 1: 0.2 more covers a short pipe",
)  # fmt: skip


@effect("upper-exponent", parameters=[EXPONENT], equation="k1 sqrt(x1) (x1/5 V)^a for k1 sqrt(x1)")
def upper_exponent(c: dict[str, Any], values: tuple[float, ...], at: Location) -> dict[str, Any]:
    """The upper outlet is a pipe rather than an orifice."""
    return {**c, "upper exponent": values[0]}


@effect("lower-exponent", parameters=[EXPONENT], equation="k3 sqrt(x2) (x2/5 V)^a for k3 sqrt(x2)")
def lower_exponent(c: dict[str, Any], values: tuple[float, ...], at: Location) -> dict[str, Any]:
    """The lower outlet is a pipe rather than an orifice."""
    return {**c, "lower exponent": values[0]}


@effect(
    "pump-saturation",
    parameters=[
        EffectParameter(
            "1/voltage", "1/V", 0.1, 0.0, 0.5, (0.17, 0.2, 0.25),
            "a pump driven by 0 to 10 V is at its limit there",
        )
    ],
    equation="k4 min(u, U) for k4 u",
)  # fmt: skip
def pump_saturation(c: dict[str, Any], values: tuple[float, ...], at: Location) -> dict[str, Any]:
    """The pump delivers no more above a voltage."""
    s = values[0]
    return pump(c, lambda u: np.minimum(u, 1.0 / s) if s > 0 else u)


@effect(
    "pump-curve",
    parameters=[
        EffectParameter(
            "curvature", "1/V", 0.03, -0.1, 0.1, (0.02, -0.02),
            "flow over voltage changes by some 30 % over 10 V on a pump's data sheet",
        )
    ],
    equation="k4 u (1 + a u) for k4 u",
)  # fmt: skip
def pump_curve(c: dict[str, Any], values: tuple[float, ...], at: Location) -> dict[str, Any]:
    """The pump's flow is not proportional to its voltage."""
    return pump(c, lambda u: u * (1.0 + values[0] * u))


@effect(
    "pump-dead-zone",
    parameters=[
        EffectParameter(
            "voltage", "V", 0.5, 0.0, 2.0, (0.2, 0.5),
            "friction holds a small motor below some 5 % of its 10 V",
        )
    ],
    equation="k4 max(u - U, 0) for k4 u",
)  # fmt: skip
def pump_dead_zone(c: dict[str, Any], values: tuple[float, ...], at: Location) -> dict[str, Any]:
    """The pump delivers nothing below a voltage."""
    return pump(c, lambda u: np.maximum(u - values[0], 0.0))


LAG = EffectParameter(
    "time", "s", 4.0, 0.0, 30.0, (4.0, 8.0), "a motor follows within a second, hoses within some"
)


@effect("pump-lag", parameters=[LAG], equation="k4 q for k4 u, T dq/dt = u - q")
def pump_lag(c: dict[str, Any], values: tuple[float, ...], at: Location) -> dict[str, Any]:
    """The pump's flow follows its voltage late."""
    return pump(c, lambda u: lagged(u, values[0]))


@effect("sensor-lag", parameters=[LAG], equation="T dy/dt = x2 - y")
def sensor_lag(c: dict[str, Any], values: tuple[float, ...], at: Location) -> dict[str, Any]:
    """The sensor follows the level late."""
    return sensor(c, lambda y: lagged(y, values[0]))


CRACK = [
    EffectParameter(
        "size", "1", 0.3, 0.0, 2.0, (0.2, 0.5),
        "over the tank's own outlet: a crack is smaller than a hole made on purpose",
    ),
    EffectParameter(
        "height", "V", 3.0, 0.0, 10.0, (5.0,), "anywhere in the wall", centre=5.0, zero_is_base=False
    ),
]  # fmt: skip


@effect(
    "upper-leak", parameters=CRACK, equation="dx1/dt less a k1 sqrt(x1 - h) where x1 > h; lost to both tanks"
)
def upper_leak(c: dict[str, Any], values: tuple[float, ...], at: Location) -> dict[str, Any]:
    """The upper tank leaks from a crack at some height; that at its foot would be the unit of x1."""
    return {**c, "upper crack": (values[0] * float(c["k1"]), values[1])}


@effect("lower-leak", parameters=CRACK, equation="dx2/dt less a k3 sqrt(x2 - h) where x2 > h")
def lower_leak(c: dict[str, Any], values: tuple[float, ...], at: Location) -> dict[str, Any]:
    """The lower tank leaks from a crack at some height."""
    return {**c, "lower crack": (values[0] * float(c["k3"]), values[1])}


@effect(
    "sensor-gain",
    parameters=[EffectParameter("gain", "1", 0.1, -0.3, 0.3, (0.05, -0.05), "the sensor is not calibrated")],
    equation="y = (1 + a) x2",
)
def sensor_gain(c: dict[str, Any], values: tuple[float, ...], at: Location) -> dict[str, Any]:
    """The sensor's gain is another; the unit of the levels takes it up, so that no record can show it."""
    return sensor(c, lambda y: (1.0 + values[0]) * y)


@effect(
    "sensor-offset",
    parameters=[
        EffectParameter(
            "offset", "V", 0.5, -2.0, 2.0, (0.2, -0.2), "5 % of its range, since it is not calibrated"
        )
    ],
    equation="y = x2 + a",
)
def sensor_offset(c: dict[str, Any], values: tuple[float, ...], at: Location) -> dict[str, Any]:
    """The sensor does not read zero when the tank is empty."""
    return sensor(c, lambda y: y + values[0])


@effect(
    "sensor-curve",
    parameters=[
        EffectParameter(
            "curvature", "1", 0.1, -0.4, 0.4, (0.05, -0.05), "10 % of full scale, since it is not calibrated"
        )
    ],
    equation="y = x2 (1 + a x2/10 V)",
)
def sensor_curve(c: dict[str, Any], values: tuple[float, ...], at: Location) -> dict[str, Any]:
    """The sensor is not linear."""
    return sensor(c, lambda y: y * (1.0 + values[0] * y / 10.0))


@effect(
    "back-pressure",
    parameters=[
        EffectParameter(
            "slope", "1/V", 0.02, 0.0, 0.1, (0.01, 0.03),
            "if the hose ends under water: a full tank adds a fifth to the head that the pump works against",
        )
    ],
    equation="k4 u (1 - a x1) for k4 u",
)  # fmt: skip
def back_pressure(c: dict[str, Any], values: tuple[float, ...], at: Location) -> dict[str, Any]:
    """The pump works against the upper tank's level."""
    return {**c, "back pressure": values[0]}


DRIFT = EffectParameter(
    "drift", "1", 0.1, -0.4, 0.4, (0.05, -0.05),
    "over the record: windings 0.4 %/K and viscosity 2 %/K over a few kelvin",
)  # fmt: skip


@effect("pump-drift", parameters=[DRIFT], equation="k4 (1 + a (t/T - 1/2)) for k4, T the record's length")
def pump_drift(c: dict[str, Any], values: tuple[float, ...], at: Location) -> dict[str, Any]:
    """The pump warms up, and delivers another flow at the end than at the start."""
    return pump(c, lambda u: u * (1.0 + values[0] * (np.arange(len(u)) / len(u) - 0.5)))


@effect("outlet-drift", parameters=[DRIFT], equation="k3 (1 + a (t/T - 1/2)) for k3, T the record's length")
def outlet_drift(c: dict[str, Any], values: tuple[float, ...], at: Location) -> dict[str, Any]:
    """The lower outlet changes in time, by the water's temperature or by deposits."""
    return {**c, "outlet drift": values[0]}


EFFECTS: tuple[Effect, ...] = (
    upper_overflow, lower_overflow, sensor_saturation, upper_exponent, lower_exponent, pump_saturation,
    pump_curve, pump_dead_zone, pump_lag, sensor_lag, upper_leak, lower_leak, sensor_gain, sensor_offset,
    sensor_curve, back_pressure, pump_drift, outlet_drift,
)  # fmt: skip


# ---------------------------------------------------------------------------------------------------
# The diagnosis of the estimation record, and the prediction of the test record


def diagnosed(record: dict[str, Array]) -> Diagnosis:
    """The diagnosis of the estimation record.

    Its errors are white noise of the sensor, some 0.02 V, and a model discrepancy or a correlated noise: a
    part of the overflow is random, and a tank keeps what it got for some 100 s (2 sqrt(x)/k).
    """
    return diagnose(data(record["yEst"]), tanks(record["uEst"]), EFFECTS, errors=Cosines())


def predictions(found: Diagnosis, u: Array) -> dict[str, Array]:
    """The level (n,) for another voltage by the baseline and by the leading set of causes, as fitted.

    All parameters, the initial levels too, are those of the estimation record.
    """
    series = {}
    for which in dict.fromkeys(((), found.sets.leader)):
        solved = found.sets.solved[which]
        model = with_effects(tanks(u), solved.forward.added)
        name = found.sets.name(which) if which else "baseline"
        series[name] = model.solve(model.configure(solved.forward.theta(solved.point.u)))[0]
    return series


def rms(values: Array) -> float:
    """Root mean square."""
    return math.sqrt(float(np.mean(values**2)))


LEADING = 8
"""Sets of causes and effects that are told."""


def report(found: Diagnosis, record: dict[str, Array]) -> str:
    """What was found, in words and tables: sets of causes, effects, root mean square errors."""
    file = found.file
    lines = [*file.lines, ""]
    lines.append("log prior  log evidence  probability  left (V)  set of causes")
    for row in found.table[:LEADING]:
        left = "" if row.gap_after is None else f"{row.gap_after:.3f}"
        names = " + ".join(row.causes) or "none"
        lines.append(
            f"{row.log_prior:9.1f}  {row.log_evidence:12.1f}  {row.probability:11.3f}  {left:>8}  {names}"
        )
    guessed = found.sets.posterior.guessed_mass
    lines += [f"{guessed:.1%} of the probability is of sets whose evidence is only estimated"]
    lines += ["", "inclusion probability"]
    for cause in found.causes[:LEADING]:
        sizes = ", ".join(f"{e.name} = {e.mean:.3g} ± {e.sd:.2g} {e.unit}" for e in cause.estimates)
        lines.append(f"{cause.name:20} {cause.probability:6.3f}  {sizes}")
    lines += ["", "rms error (V)                                        estimation   test"]
    for (name, test), fitted in zip(
        predictions(found, record["uVal"]).items(), predictions(found, record["uEst"]).values(), strict=True
    ):
        lines.append(f"{name:52} {rms(record['yEst'] - fitted):10.3f} {rms(record['yVal'] - test):6.3f}")
    return "\n".join([*lines, "", f"{file.record['seconds']:.0f} s"])


def figure(found: Diagnosis, record: dict[str, Array], path: Path) -> None:
    """The test record with its predictions, what they leave, and the probability of each effect."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(3, 1, figsize=(7.2, 8.4), height_ratios=(2, 1.4, 2.4), layout="constrained")
    minutes = times(len(record["yVal"])) / 60.0
    axes[0].plot(minutes, record["yVal"], "k", lw=0.8, label="measured")
    for i, (name, level) in enumerate(predictions(found, record["uVal"]).items()):
        label = f"{name}: rms error {rms(record['yVal'] - level):.2f} V"
        axes[0].plot(minutes, level, f"C{i}", lw=0.9, label=label)
        axes[1].plot(minutes, record["yVal"] - level, f"C{i}", lw=0.9)
    axes[0].set(ylabel="level (V)", title="Test record, predicted with the estimation record's parameters")
    axes[0].legend(loc="upper center", bbox_to_anchor=(0.5, -0.06), ncols=1, frameon=False, fontsize=8)
    axes[1].axhline(0.0, color="0.6", lw=0.6)
    axes[1].set(ylabel="measured minus\npredicted (V)", xlabel="time (min)")
    causes = found.causes[::-1]
    axes[2].barh([one.name for one in causes], [one.probability for one in causes], color="C2", height=0.7)
    axes[2].set(xlabel="inclusion probability, estimation record", xlim=(0.0, 1.0))
    axes[2].tick_params(axis="y", labelsize=7)
    for ax in axes:
        ax.spines[["top", "right"]].set_visible(False)
    fig.savefig(path, dpi=130)
    plt.close(fig)


def main(arguments: Sequence[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--figure", type=Path, help="write a figure to this file")
    chosen = parser.parse_args(arguments)
    record = read(fetch_file("cascaded-tanks/dataBenchmark.csv"))
    found = diagnosed(record)
    print(report(found, record))
    if chosen.figure:
        figure(found, record, chosen.figure)


if __name__ == "__main__":
    main()
