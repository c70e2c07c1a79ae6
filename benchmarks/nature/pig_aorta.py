"""Pressure and flow of a pig's aorta: a three-element Windkessel as base, and eleven rivals.

P_k = Z(omega_k) Q_k for each harmonic of the mean beat, Z = R1 + R2 / (1 + i omega R2 C); pressures in mmHg,
flows in ml/s. Prior sizes are from physiology and from what sensors can be off by, and were chosen before
any diagnosis with this base.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.nature import Parameters, rival
from numpy.typing import NDArray

import zoo
from zoo.core.diagnosis import Diagnosis

Array = NDArray[np.float64]


def windkessel(period_s: float, flow: Array) -> Callable[[Parameters, Array], Array]:
    """Pressure (n_times,) of the mean beat's flow (n,), evenly sampled."""
    n = len(flow)
    omega = 2.0 * np.pi * np.fft.rfftfreq(n, period_s / n)
    spectrum = np.fft.rfft(flow)

    def simulate(c: Parameters, times: Array) -> Array:
        Z = c["R1"] + c["R2"] / (1.0 + 1j * omega * c["R2"] * c["C"])
        Z = Z + 1j * omega * c.get("inertance", 0.0)
        Z = Z / (1.0 + Z * (1j * omega * c.get("second", 0.0) + c.get("leak", 0.0)))
        Z = Z * (1.0 + c.get("reflection", 0.0) * np.exp(-1j * omega * c.get("delay", 0.1)))
        sensor = np.exp(-1j * omega * c.get("pressure_late", 0.0)) / (1.0 + 1j * omega * c.get("slow", 0.0))
        source = spectrum * np.exp(1j * omega * c.get("flow_late", 0.0)) * (1.0 + c.get("gain", 0.0))
        wave = np.fft.irfft(Z * source * sensor, n)
        if c.get("stiffening", 0.0) != 0.0:  # C falls with the pressure, to first order
            mean = wave.mean()
            bend = np.fft.rfft(c["stiffening"] * (wave - mean) ** 2 / (2.0 * mean))
            wave = wave + np.fft.irfft(bend * np.where(omega > 0.0, 1.0, 0.0), n)
        part = np.asarray(times) / period_s
        wave = np.interp(part, np.arange(n + 1) / n, np.append(wave, wave[0]))
        return np.asarray(wave + c.get("offset", 0.0) + c.get("drift", 0.0) * (part - 0.5))

    return simulate


@zoo.effect(
    "wave-reflection-delay",
    parameters=[
        zoo.EffectParameter("part", "1", 0.2, -0.9, 0.9, (0.2, -0.2)),
        zoo.EffectParameter("delay", "s", 0.05, 0.01, 0.3, (), centre=0.1, zero_is_base=False),
    ],
)
def reflection(c: Parameters, values: tuple[float, ...], at: Any) -> dict[str, Any]:
    """A reflected wave that returns later."""
    return {**c, "reflection": values[0], "delay": values[1]}


RIVALS = [
    rival("flow-timing", "flow_late", "s", 0.03, -0.2, 0.2),  # positive: the flow's record is late
    rival("pressure-timing", "pressure_late", "s", 0.03, -0.2, 0.2),
    rival("flow-gain", "gain", "1", 0.1, -0.9),
    rival("offset", "offset", "mmHg", 5.0),
    rival("bandwidth", "slow", "s", 0.01, 0.0),  # of the pressure's sensor
    rival("inertance", "inertance", "mmHg s2/ml", 0.005, 0.0),
    rival("second-compliance", "second", "ml/mmHg", 0.3, 0.0),
    rival("non-linear-compliance", "stiffening", "1", 1.0, -5.0, 5.0),
    reflection,
    rival("leak", "leak", "ml/(s mmHg)", 0.1, 0.0),
    rival("baseline-drift", "drift", "mmHg", 3.0),
]
PRIORS = {
    "R1": zoo.Parameter("R1", zoo.LogNormal(0.05, 1.0), "mmHg s/ml"),
    "R2": zoo.Parameter("R2", zoo.LogNormal(1.0, 1.0), "mmHg s/ml"),
    "C": zoo.Parameter("C", zoo.LogNormal(1.0, 1.0), "ml/mmHg"),
}


def mean_beat(folder: Path, record: int) -> tuple[float, Array, Array, Array]:
    """Period (s), times (s), pressure (mmHg) and flow (ml/s) of a record's mean beat."""
    files = (folder / f"invivo_record{record}_{x}.csv" for x in "PQ")
    study = zoo.import_beats(*files, length_cm=6.0, radius_cm=1.1).study
    pressure = study.series[0].value
    times = study.period_s * np.arange(len(pressure)) / len(pressure)
    flow = np.interp(times, study.inflow_time_s, study.inflow_ml_s, period=study.period_s)
    return study.period_s, times, np.asarray(pressure), flow


def diagnose_pig(folder: Path) -> Diagnosis:
    """Record 1; what was learned is tried on record 2."""
    period, times, pressure, flow = mean_beat(folder, 1)
    second = mean_beat(folder, 2)
    held_out = {"record 2": (second[1], second[2], windkessel(second[0], second[3]))}
    return zoo.diagnose(
        times, pressure, windkessel(period, flow), PRIORS, RIVALS, labels=["pressure"], units=["mmHg"],
        held_out=held_out,
    )  # fmt: skip
