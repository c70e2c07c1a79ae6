"""Input impedance of a tree at its root, measured and modelled, by harmonic."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zoo.blood.case import Case, simulate
from zoo.core.arrays import Array
from zoo.core.data import Data

HARMONICS = 15
DRAWS = 2000
LEVEL = 0.95
"""Of the intervals."""
FLOW_NOISE_PART = 0.01
"""Noise of a sample of the flow record, as a part of its peak, where none is given."""
WEAK_PART = 0.5
"""A harmonic of the flow is weak below this part of the geometric mean of its neighbours."""
WEAK_SDS = 3.0
"""It is weak, too, below so many standard deviations of its noise."""
SPIKE = 1.5
"""An impedance is a spike where all its interval is above so many times its neighbours' geometric mean."""
SAMPLES = 512
"""Of a beat, in a solve."""


class ImpedanceError(ValueError):
    """Series from which no impedance follows; the text says why and what to give."""


@dataclass(frozen=True, eq=False)
class Impedance:
    """Z_k = P_k/Q_k at the harmonics of the beat, from 0 (the steady resistance) up.

    Parameters
    ----------
    frequency_Hz : array (m,)
    value : complex array (m,)
        mmHg s/ml.
    modulus_low, modulus_high : array (m,)
        Interval of the modulus, mmHg s/ml; the modulus itself where nothing is noisy.
    phase_low, phase_high : array (m,)
        Interval of the phase, rad, around `phase`.
    flow_part : array (m,)
        abs(Q_k)/abs(Q_1).
    weak : bool array (m,)
        Where the flow's harmonic is nearly zero beside its neighbours or its noise, so that the impedance
        says more of the flow record than of the tree.
    """

    frequency_Hz: Array
    value: NDArray[np.complex128]
    modulus_low: Array
    modulus_high: Array
    phase_low: Array
    phase_high: Array
    flow_part: Array
    weak: NDArray[np.bool_]

    @property
    def modulus(self) -> Array:
        """abs(Z), mmHg s/ml, (m,)."""
        return np.asarray(np.abs(self.value))

    @property
    def phase(self) -> Array:
        """rad, (m,); negative where flow leads pressure."""
        return np.asarray(np.angle(self.value))

    @property
    def spike(self) -> NDArray[np.bool_]:
        """Where a weak harmonic's impedance is far above its neighbours', with its interval, (m,)."""
        return np.asarray(self.weak & (self.modulus_low > SPIKE * _neighbours(self.modulus)))

    def sentences(self) -> list[str]:
        """What each spike points to, in words."""
        between = _neighbours(self.modulus)
        return [
            f"at harmonic {k} ({self.frequency_Hz[k]:.3g} Hz) the impedance is "
            f"{self.modulus[k] / between[k]:.1f} times that of its neighbours, where the flow is "
            f"{100 * self.flow_part[k]:.2g} % of its first harmonic: this points to the flow record, not to "
            "the tree"
            for k in np.flatnonzero(self.spike)
        ]


def measured_impedance(
    data: Data,
    case: Case,
    *,
    noise_mmHg: float,
    flow_noise_ml_s: float | None = None,
    harmonics: int = HARMONICS,
    seed: int = 1,
) -> Impedance:
    """Impedance of the observed pressure at the root's inlet over the recorded inflow.

    Intervals are quantiles of draws of both harmonics: white noise of standard deviation s in n samples moves
    the real and imaginary part of a harmonic by s sqrt(2/n) each. Samples at uneven times are read at even
    ones, linear between.

    Parameters
    ----------
    data : Data
        Of one period.
    case : Case
        With the recorded inflow, `zoo.blood.blood_flow.BloodFlow.configure` without effects; the conventions'
        lag of the samples is counted.
    noise_mmHg : float
        Sd of the pressure's white noise.
    flow_noise_ml_s : float, optional
        Sd of the flow's, as if sampled as often as the pressure; a hundredth of its peak if absent.
    harmonics : int
        The last one; fewer where samples allow no more.
    seed : int

    Returns
    -------
    Impedance

    Raises
    ------
    ImpedanceError
        If the pressure at the root's inlet is not observed, or no flow was recorded there.
    """
    if not case.inflow_ml_s.size:
        raise ImpedanceError(
            "impedance: the study gives inlet_pressure, and no flow to divide by; give inflow"
        )
    network, period = case.network, case.network.period_s
    root = int(network.ids[0])
    place = (root, 0.0, "pressure_mmHg")
    if place not in data.outputs:
        raise ImpedanceError(
            f"impedance: pressure at position 0 of vessel {root} is not observed; add it to observations.csv"
        )
    row = data.outputs.index(place)
    wave = data.samples(row)
    n = len(wave)
    if not data.even:
        even = data.times[0] + np.arange(n) * (period / n)
        wave = np.interp(even, data.times[data.measured[row]], wave, period=period)
    start = data.times[0] + case.conventions.sample_lag_beats * period
    last = min(harmonics, (n - 1) // 2, (len(case.inflow_ml_s) - 1) // 2)
    pressure = _harmonics(wave, last, start / period)
    flow = _entering(case.inflow_ml_s, last)
    sd_q = FLOW_NOISE_PART * float(np.abs(case.inflow_ml_s).max())
    sd_q = sd_q if flow_noise_ml_s is None else flow_noise_ml_s
    return _ratio(pressure, flow, period, noise_mmHg * math.sqrt(2 / n), sd_q * math.sqrt(2 / n), seed)


def modelled_impedance(
    case: Case, *, recorded_ml_s: ArrayLike | None = None, harmonics: int = HARMONICS
) -> Impedance:
    """Impedance of the solved pressure at the root's inlet.

    Parameters
    ----------
    case : Case
        Solve at the parameters, as it is or changed by effects and free functions. What sensors do to the
        pressure is part of it.
    recorded_ml_s : array (n,), optional
        The recorded inflow, by which a measured impedance is divided: with it, a change of the inflow is seen
        as it would be in a measured one. The flow that enters if absent.
    harmonics : int
        The last one.

    Returns
    -------
    Impedance
        Its intervals have no width.

    Raises
    ------
    SolveError
        If the solve fails.
    """
    period, root = case.network.period_s, int(case.network.ids[0])
    times = np.arange(SAMPLES) * (period / SAMPLES)
    pressure, flow = simulate(case, [(root, 0.0, name) for name in ("pressure_mmHg", "flow_ml_s")], times)
    entering = case.inflow_ml_s if recorded_ml_s is None else np.asarray(recorded_ml_s, dtype=np.float64)
    last = min(harmonics, (SAMPLES - 1) // 2, ((len(entering) or SAMPLES) - 1) // 2)
    under = _entering(entering, last) if len(entering) else _harmonics(flow, last)
    return _ratio(_harmonics(pressure, last), under, period)


def _harmonics(values: ArrayLike, last: int, start_beats: float = 0.0) -> NDArray[np.complex128]:
    """Complex amplitudes c_k of Re(c_k exp(2 pi i k t/T)), k from 0 to `last`; samples begin at `start`."""
    series = np.asarray(values, dtype=np.float64)
    k = np.arange(last + 1)
    found = np.fft.rfft(series)[: last + 1] * np.where(k == 0, 1.0, 2.0) / len(series)
    return np.asarray(found * np.exp(-2j * math.pi * k * start_beats))


def _entering(values: ArrayLike, last: int) -> NDArray[np.complex128]:
    """Harmonics of a flow that is linear between its samples, as the solver takes it."""
    series = np.asarray(values, dtype=np.float64)
    return np.asarray(_harmonics(series, last) * np.sinc(np.arange(last + 1) / len(series)) ** 2)


def _neighbours(size: Array) -> Array:
    """Geometric mean of the values before and after each; of one where the other is 0th or beyond the end."""
    logs = np.log(np.maximum(size, 1e-300))
    before, after = np.roll(logs, 1), np.roll(logs, -1)
    before[:2], after[-1] = after[:2], before[-1]
    found = np.exp(0.5 * (before + after))
    found[0] = size[0]
    return np.asarray(found)


def _ratio(
    pressure: NDArray[np.complex128],
    flow: NDArray[np.complex128],
    period: float,
    sd_p: float = 0.0,
    sd_q: float = 0.0,
    seed: int = 1,
) -> Impedance:
    size = np.abs(flow)
    with np.errstate(divide="ignore", invalid="ignore"):
        value = np.where(size > 0, pressure / flow, np.nan)
    weak = (size < WEAK_PART * _neighbours(size)) | (size < WEAK_SDS * sd_q)
    weak[0] = False
    found = Impedance(
        np.arange(len(flow)) / period,
        value,
        *(np.abs(value),) * 2,
        *(np.angle(value),) * 2,
        size / size[1] if size[1] else np.full(len(size), np.nan),
        weak,
    )
    if not sd_p and not sd_q:
        return found
    random = np.random.default_rng(seed)

    def draws(sd: float) -> NDArray[np.complex128]:
        parts = sd * random.standard_normal((2, DRAWS, len(flow)))
        made = parts[0] + 1j * parts[1]
        made[:, 0] = made[:, 0].real / math.sqrt(2)  # a mean varies by s/sqrt(n)
        return np.asarray(made)

    drawn = (pressure + draws(sd_p)) / (flow + draws(sd_q))
    tails = [(1 - LEVEL) / 2, (1 + LEVEL) / 2]
    low, high = np.quantile(np.abs(drawn), tails, axis=0)
    turn_low, turn_high = np.quantile(np.angle(drawn / value), tails, axis=0) + found.phase
    return replace(found, modulus_low=low, modulus_high=high, phase_low=turn_low, phase_high=turn_high)
