"""Causes that no catalogue lists, each in a known component: laws of physics, of probes and of catheters.

Each has a size and a shape; none is a Gaussian process or a spline of a few knots, as the free functions of a
diagnosis are.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.blood.case import Case, Wave, filtered, with_network, with_physics, with_true_lengths, with_wave
from zoo.blood.effects.outflow import blended_sections, sections_of
from zoo.blood.functions import FrictionFunction, JunctionFunction, WallFunction
from zoo.core.effects import Effect, EffectParameter, Location

Array = NDArray[np.float64]
Change = Callable[..., Case]
PATTERNS = 10_000
"""Draws of which vessels a cause acts on: the shape "pattern" is a whole number below this."""


@dataclass(frozen=True)
class Cause:
    """A law that the baseline lacks and no catalogue has: ``change(case, size, **shape) -> case``.

    Its size is 0 in the baseline and drawn log-uniformly from `low` to `high`; each number of its shape is
    uniform between its limits in `shapes`.
    """

    name: str
    component: str
    low: float
    high: float
    change: Change
    shapes: Mapping[str, tuple[float, float]]

    def draw(self, rng: np.random.Generator) -> tuple[Effect, float, dict[str, float]]:
        """The cause with a drawn shape as an effect whose only parameter is the size; a size; the shape."""
        shape = {name: float(f"{rng.uniform(*limits):.6g}") for name, limits in self.shapes.items()}
        size = float(f"{math.exp(rng.uniform(math.log(self.low), math.log(self.high))):.6g}")
        return self.effect(shape), size, shape

    def effect(self, shape: Mapping[str, float]) -> Effect:
        """The cause of this shape as an effect."""

        def apply(case: Case, values: tuple[float, ...], location: Location) -> Case:
            return self.change(case, values[0], **shape) if values[0] else case

        size = EffectParameter("size", "1", self.high, -2 * self.high, 2 * self.high, (self.low,))
        family = {"outlets": "outflow"}.get(self.component, self.component)
        text = (self.change.__doc__ or "").strip()
        return Effect(self.name, (size,), apply, family=family, statement=text, equation=text)


CAUSES: dict[str, Cause] = {}
"""By name; none of these is in `zoo.blood.effects.CATALOGUE`."""


def cause(
    component: str, sizes: tuple[float, float], **shapes: tuple[float, float]
) -> Callable[[Change], Cause]:
    """Make a cause of the function that changes the case, by whose name it is called."""

    def made(change: Change) -> Cause:
        name = change.__name__.replace("_", "-")
        CAUSES[name] = Cause(name, component, *sizes, change, shapes)
        return CAUSES[name]

    return made


def phases(n: int) -> Array:
    """Uniform samples of a beat from 0, in beats, (n,)."""
    return np.asarray(np.arange(n) / n)


def bump(phase: Array, centre: float, width: float) -> Array:
    """A periodic bump of height 1: exp((cos(2 pi (phase - centre)) - 1)/(2 pi width)^2), width its sd."""
    return np.asarray(np.exp((np.cos(2 * np.pi * (phase - centre)) - 1) / (2 * np.pi * width) ** 2))


def ramp(x: Array) -> Array:
    """log(1 + exp(x)), a smooth max(x, 0)."""
    return np.asarray(np.logaddexp(0.0, x))


def picked(among: NDArray[Any], many: int, pattern: float) -> NDArray[Any]:
    """Some members, by the number of a pattern: the same number picks the same ones."""
    order = np.random.default_rng(int(pattern)).permutation(len(among))
    return np.asarray(among[np.sort(order[: max(1, min(many, len(among)))])])


# -- the inflow ------------------------------------------------------------------------------------------


def _with_more(case: Case, added: Array) -> Case:
    return replace(case, inflow_ml_s=case.inflow_ml_s + added)


def _peak(flow: Array) -> float:
    return float(np.argmax(flow) / len(flow))


@cause("inflow", (0.02, 0.6), power=(1.0, 3.0), rise=(0.01, 0.04), delay=(-0.02, 0.04))
def late_saturation(case: Case, size: float, *, power: float, rise: float, delay: float) -> Case:
    """The probe reads too little of the flow from the peak on, the less the larger it is.

    q_true = q (1 + a h(t) (q/q_max)^m), h from 0 to 1 within a few per cent of a beat about peak.
    """
    flow = case.inflow_ml_s
    since = phases(len(flow)) - _peak(flow) - delay
    share = np.clip(flow / flow.max(), 0.0, None) ** power
    on = 0.5 * (1 + np.tanh(since / rise)) * 0.5 * (1 - np.tanh((since - 0.5) / rise))
    return _with_more(case, size * flow * share * on)


@cause("inflow", (0.004, 0.25), at=(0.5, 0.95), reset=(0.01, 0.05), sign=(-1.0, 1.0))
def baseline_reset(case: Case, size: float, *, at: float, reset: float, sign: float) -> Case:
    """The zero of the probe drifts within each beat and is set back once in it.

    q_true = q + a q_max (s(t) - 1/2), s a saw-tooth over the beat, reset in a few per cent of it; a in
    peak flow.
    """
    flow = case.inflow_ml_s
    since = np.mod(phases(len(flow)) - at, 1.0)
    saw = np.where(since < reset, 0.5 + 0.5 * np.cos(np.pi * since / reset), (since - reset) / (1 - reset))
    return _with_more(case, np.copysign(size, sign) * flow.max() * (saw - saw.mean()))


@cause("inflow", (0.1, 2.5), cycles=(8.0, 25.0), decay=(0.02, 0.08))
def probe_ringing(case: Case, size: float, *, cycles: float, decay: float) -> Case:
    """The probe rings after fast edges; the record holds that, and the flow does not.

    q = q_true + a k * q', k(s) = exp(-s/tau) sin(2 pi f s)/f, the edges' ringing.
    """
    flow = case.inflow_ml_s
    harmonic = 2j * np.pi * np.arange(len(flow) // 2 + 1)
    turn = 2 * np.pi * cycles
    kernel = turn / ((harmonic + 1 / decay) ** 2 + turn**2)
    rung = np.fft.irfft(np.fft.rfft(flow) * harmonic * kernel, len(flow))
    return _with_more(case, -size * rung)


@cause("inflow", (0.02, 0.8), after=(0.28, 0.5), width=(0.015, 0.05))
def closing_backflow(case: Case, size: float, *, after: float, width: float) -> Case:
    """Some blood flows back while the valve closes, which the averaged record does not hold.

    q_true = q - a q_max b(t), b a bump of height 1 after the end of ejection; a in peak flow.
    """
    flow = case.inflow_ml_s
    return _with_more(case, -size * flow.max() * bump(phases(len(flow)), _peak(flow) + after, width))


def _closure(flow: Array) -> int:
    """First sample after the peak at which the inflow is below 2 % of it."""
    peak = int(np.argmax(flow))
    below = np.flatnonzero(flow[peak:] < 0.02 * flow[peak])
    return min(peak + int(below[0]) if len(below) else peak, len(flow) - 8)


@cause("inflow", (0.02, 0.6))
def leaking_valve(case: Case, size: float) -> Case:
    """A share of the stroke flows back through the inlet's valve in diastole.

    q -> q - f mean(q) w(t), w in diastole, of mean 1.
    """
    flow = case.inflow_ml_s
    start = _closure(flow)
    back = np.zeros(len(flow))
    back[start:] = np.sin(np.pi * np.arange(len(flow) - start) / (len(flow) - start)) ** 2
    return _with_more(case, -size * flow.mean() * back / back.mean())


@cause("inflow", (0.02, 0.8))
def valve_click(case: Case, size: float) -> Case:
    """The inflow rings just after the valve closes.

    q -> q + a max(q) sin(2 pi 9 s) exp(-s/0.05), s the beats since closure; a in peak flow.
    """
    flow = case.inflow_ml_s
    since = (np.arange(len(flow)) - _closure(flow)) / len(flow)
    ring = np.where(since > 0, np.sin(2 * np.pi * 9 * since) * np.exp(-np.clip(since, 0, None) / 0.05), 0.0)
    return _with_more(case, size * float(flow.max()) * ring)


# -- the wall --------------------------------------------------------------------------------------------


STRETCH, KNOTS = (0.7, 1.55), 256
"""Range of sqrt(A/A0) and knots of a table of a law."""


@cause("wall", (0.05, 1.5), pattern=(0.0, PATTERNS))
def patchy_stiffening(case: Case, size: float, *, pattern: float) -> Case:
    """A third of the vessels is stiffer than the others: chi -> chi exp(a) in a third of the vessels."""
    n = len(case.network.ids)
    some = picked(np.arange(n), max(2, round(n / 3)), pattern)
    factor = np.ones(n)
    factor[some] = np.exp(size)
    return replace(case, stiffness=case.stiffness * factor)


@cause("wall", (0.03, 1.0), at=(0.05, 0.95), width=(0.05, 0.12))
def pulsing_tone(case: Case, size: float, *, at: float, width: float) -> Case:
    """Muscle in the wall contracts once in every beat: chi -> chi (1 + a b(t)), b a bump of height 1."""
    return with_physics(case, stiffness_wave=1 + size * bump(phases(256), at, width))


def _with_law(case: Case, law: Callable[[Array], Array]) -> Case:
    """The linear wall with another law of the stretch s, in units of (4/3) chi; s - 1 is the linear one."""
    stretch = np.linspace(*STRETCH, KNOTS)
    return with_physics(case, wall_function=WallFunction(*STRETCH, tuple(law(stretch) - (stretch - 1))))


@cause("wall", (0.5, 20.0))
def fung_wall(case: Case, size: float) -> Case:
    """The wall stiffens exponentially with the square of its strain.

    p = (4/3) chi e exp(a e^2), e = sqrt(A/A0) - 1. Fung et al. 1979, doi 10.1152/ajpheart.1979.237.5.H620
    (exponential in the strain squared)
    """
    return _with_law(case, lambda s: (s - 1) * np.exp(size * (s - 1) ** 2))


@cause("wall", (0.4, 1.3), largest=(2.55, 3.5))
def arctangent_wall(case: Case, size: float, *, largest: float) -> Case:
    """The area goes to a largest one by an arctangent: soft at middling pressures, stiff at high ones.

    A/A_m = 1/2 + arctan((p - p_0)/p_1)/pi, with slope and pressure at rest as the linear wall.
    Langewouters et al. 1984, doi 10.1016/0021-9290(84)90034-4
    """
    rest, slope = np.pi * (1 / largest - 0.5), np.pi / largest / np.cos(np.pi * (1 / largest - 0.5)) ** 2

    def law(s: Array) -> Array:
        tangent = np.tan(np.pi * (s**2 / largest - 0.5)) - np.tan(rest)
        return np.asarray((1 - size) * (s - 1) + size * tangent / (2 * slope))

    return _with_law(case, law)


@cause("wall", (0.1, 6.0), engaged=(1.12, 1.32), width=(0.01, 0.04))
def collagen_wall(case: Case, size: float, *, engaged: float, width: float) -> Case:
    """Collagen is recruited around a stretch: from there on the wall is stiffer.

    p = (4/3) chi (s - 1 + a w log(1 + exp((s - s_c)/w))), s = sqrt(A/A0). Roach and Burton 1957, doi
    10.1139/o57-080 (collagen takes over beyond a stretch)
    """
    return _with_law(case, lambda s: s - 1 + size * width * ramp((s - engaged) / width))


# -- outlets: circuits that are neither a Windkessel nor a listed tree -----------------------------------


SPREAD = 0.25
"""Between time constants of neighbouring sections of a constant-phase element, in their logarithm."""
SHORTEST, LONGEST = -5.0, 2.0
"""Logarithms of the least and largest time constant over R2 C."""
LADDER = 8


def constant_phase_sections(lack: float) -> tuple[float, Array, Array]:
    """Sections of R2/(1 + (i w R2 C)^(1 - lack)), by its distribution of time constants.

    Cole and Cole's distribution of x = log(tau/(R2 C)), sin(a pi)/(2 pi (cosh((1 - a) x) - cos(a pi))) with
    a the lack, in steps of `SPREAD`; what is faster than the shortest is a resistance.

    Given back are the resistance without compliance, in units of R2, and rho and kappa as `Physics` has them.

    References
    ----------
    Cole and Cole 1941, doi 10.1063/1.1750906.
    """
    x = np.arange(round(-60 / SPREAD), round(60 / SPREAD) + 1) * SPREAD
    fine = x[:, None] + SPREAD * (np.arange(16) + 0.5 - 8) / 16
    density = np.sin(lack * np.pi) / (np.cosh((1 - lack) * fine) - np.cos(lack * np.pi))
    weight = density.mean(axis=1)
    weight /= weight.sum()
    held = (x >= SHORTEST) & (x <= LONGEST)
    rho = weight[held]
    rho[-1] += weight[x > LONGEST].sum()
    return float(weight[x < SHORTEST].sum()), rho, np.exp(x[held]) / rho


@functools.cache
def ladder_sections(resistance: float, compliance: float, n: int = LADDER) -> tuple[Array, Array]:
    """Sections of a ladder whose resistances and compliances change by a factor from node to node.

    C_k dv_k/dt = (v_(k-1) - v_k)/R_(k-1) - (v_k - v_(k+1))/R_k, R_k = R_1 resistance^k, C_k alike; the first
    node is fed, the last drains. With eigenvalues l and vectors u of C^(-1/2) G C^(-1/2), Z is the sum of
    (u_1^2/C_1)/(l + i w).

    Given back are rho and kappa, in units of the whole resistance and compliance.
    """
    R, C = resistance ** np.arange(n), compliance ** np.arange(n)
    g, C = R.sum() / R, C / C.sum()
    G = np.diag(g) + np.diag(np.concatenate([[0.0], g[:-1]])) - np.diag(g[:-1], 1) - np.diag(g[:-1], -1)
    root = 1 / np.sqrt(C)
    values, vectors = np.linalg.eigh(root[:, None] * G * root)
    weight = vectors[0] ** 2 / C[0]
    return weight / values, 1 / weight


@cause("outlets", (0.03, 0.6))
def constant_phase(case: Case, size: float) -> Case:
    """Resistance and compliance behind the outlets have a time constant of every length.

    Z = R1 + R2/(1 + (i w R2 C)^(1 - a)), by 29 sections. Cole and Cole 1941, doi 10.1063/1.1750906
    """
    fast, rho, kappa = constant_phase_sections(abs(size))
    net, shape = case.network, (len(case.network.ids), 1)
    psi1 = case.psi1.copy()
    at = net.terminals
    psi1[at] += fast * (case.psi2 * net.R2)[at] / net.R1[at]
    changed = with_physics(
        case, section_resistance=np.tile(rho, shape), section_compliance=np.tile(kappa, shape)
    )
    return replace(changed, psi1=psi1)


@cause("outlets", (0.05, 1.0), resistance=(0.3, 0.75), compliance=(1.3, 2.2))
def tapering_ladder(case: Case, size: float, *, resistance: float, compliance: float) -> Case:
    """Behind each outlet resistance lies near and compliance far, in generations.

    Z = (1 - a) Z_3 + a Z_l, Z_l of a ladder of 8 nodes with R_k+1 = x R_k, C_k+1 = y C_k. Westerhof et
    al. 1969, doi 10.1016/0021-9290(69)90024-4 (ladders of a branching tree)
    """
    rows = (len(case.network.ids), 1)
    rho, kappa = (np.tile(x, rows) for x in ladder_sections(resistance, compliance))
    return with_physics(case, **blended_sections([(1 - size, *sections_of(case)), (size, rho, kappa)]))


@cause("outlets", (0.2, 3.0), outlets=(2.0, 4.999), pattern=(0.0, PATTERNS))
def blocked_outlets(case: Case, size: float, *, outlets: float, pattern: float) -> Case:
    """A few outlets are blocked in part.

    R1, R2 -> exp(a) R1, exp(a) R2 and C -> exp(-a/2) C at two to four outlets.
    """
    terminals = case.network.terminals
    some = picked(terminals, min(int(outlets), len(terminals) - 1), pattern)
    psi1, psi2, c = case.psi1.copy(), case.psi2.copy(), case.c.copy()
    psi1[some] *= np.exp(size)
    psi2[some] *= np.exp(size)
    c[some] *= np.exp(-size / 2)
    return replace(case, psi1=psi1, psi2=psi2, c=c)


# -- the fluid -------------------------------------------------------------------------------------------


FASTEST_BLOOD, FRICTION_KNOTS = 200.0, 401
"""Speed (cm/s) to which a table of a factor goes, and its knots."""


@cause("fluid", (0.3, 2.5))
def viscous_small_vessels(case: Case, size: float) -> Case:
    """Blood is thicker the narrower the vessel: mu -> mu (r_root/r)^a."""
    net = case.network
    radius = 0.5 * (net.radius_in_cm + net.radius_out_cm)
    factor = (radius.max() / radius) ** size
    old = case.physics.viscosity_factor
    return with_physics(case, viscosity_factor=factor if old is None else old * factor)


def _with_factor(case: Case, factor: Callable[[Array], Array]) -> Case:
    """Friction times a factor of the blood's speed (cm/s)."""
    speed = np.linspace(0.0, FASTEST_BLOOD, FRICTION_KNOTS)
    return with_physics(case, friction_function=FrictionFunction(0.0, FASTEST_BLOOD, tuple(factor(speed))))


@cause("fluid", (0.05, 1.2), least=(1.0, 5.0), reference=(8.0, 25.0))
def power_law_blood(case: Case, size: float, *, least: float, reference: float) -> Case:
    """Blood gets thinner the faster it flows, by a power.

    friction times ((u^2 + u_0^2)/u_r^2)^(-a/2). Pedley 1980, The Fluid Mechanics of Large Blood Vessels
    (blood is thinner at higher shear)
    """
    return _with_factor(case, lambda u: ((u**2 + least**2) / reference**2) ** (-size / 2))


@cause("fluid", (0.1, 10.0), critical=(12.0, 35.0))
def disturbed_flow(case: Case, size: float, *, critical: float) -> Case:
    """Beyond a critical speed the flow is disturbed and rubs more.

    friction times 1 + a (w/u_c) log(1 + exp((u - u_c)/w)), w = u_c/10. Young and Tsai 1973, doi
    10.1016/0021-9290(73)90099-7 (losses beyond a critical speed)
    """
    width = critical / 10
    return _with_factor(case, lambda u: 1 + size * width / critical * ramp((u - critical) / width))


@cause("fluid", (0.3, 12.0), critical=(1.5, 10.0))
def aggregating_cells(case: Case, size: float, *, critical: float) -> Case:
    """Blood that hardly moves is thicker.

    friction times 1 + a/(1 + (u/u_c)^2). Chien 1970, doi 10.1126/science.168.3934.977 (red cells
    aggregate at low shear)
    """
    return _with_factor(case, lambda u: 1 + size / (1 + (u / critical) ** 2))


# -- junctions -------------------------------------------------------------------------------------------


FASTEST, KNOTS = 200.0, 801
"""Velocity (cm/s) to which a table of a loss goes either way, and its knots."""
REFERENCE = 40.0
"""cm/s, at which laws of other powers lose what the square does."""
WIDTH = 2.0
"""cm/s, over which flow begins to separate."""


def _with_loss(case: Case, loss: Callable[[Array], Array]) -> Case:
    """A loss in units of rho/2 u^2 (cm/s, squared)."""
    velocity = np.linspace(-FASTEST, FASTEST, KNOTS)
    lost = 0.5 * case.network.density * loss(velocity)
    return with_physics(case, junction_function=JunctionFunction(-FASTEST, FASTEST, tuple(lost)))


def _power(u: Array, power: float) -> Array:
    return np.asarray(np.sign(u) * REFERENCE**2 * (np.abs(u) / REFERENCE) ** power)


@cause("junctions", (0.05, 8.0), power=(2.8, 4.5))
def steep_loss(case: Case, size: float, *, power: float) -> Case:
    """Junctions lose more than with the square of the velocity.

    D = a rho/2 u_r^2 sign(u) (abs(u)/u_r)^m, m from 2.8 to 4.5.
    """
    return _with_loss(case, lambda u: size * _power(u, power))


@cause("junctions", (0.05, 8.0), power=(1.0, 1.4))
def flat_loss(case: Case, size: float, *, power: float) -> Case:
    """Junctions lose little more than in proportion to the velocity, as slow viscous flow does.

    D = a rho/2 u_r^2 sign(u) (abs(u)/u_r)^m, m from 1 to 1.4.
    """
    return _with_loss(case, lambda u: size * _power(u, power))


@cause("junctions", (0.1, 12.0), critical=(12.0, 35.0))
def separating_flow(case: Case, size: float, *, critical: float) -> Case:
    """Beyond a critical velocity the flow separates where it divides.

    D = a rho/2 (w log(1 + exp((u - u_c)/w)))^2, w = 2 cm/s: nothing below u_c, nothing backwards.
    """
    return _with_loss(case, lambda u: size * (WIDTH * ramp((u - critical) / WIDTH)) ** 2)


# -- geometry --------------------------------------------------------------------------------------------


def _radii(case: Case, factor: Array) -> Case:
    net = case.network
    return with_network(
        case, radius_in_cm=net.radius_in_cm * factor, radius_out_cm=net.radius_out_cm * factor
    )


@cause("geometry", (0.03, 0.7), corner=(0.35, 0.8))
def shrunk_small_vessels(case: Case, size: float, *, corner: float) -> Case:
    """Vessels narrower than some radius were wider in life than in the image.

    r_true = r (1 + a/(1 + (r/r_c)^4)), r_c a part of the root's radius.
    """
    radius = case.network.radius_in_cm
    return _radii(case, 1 + size / (1 + (radius / (corner * radius.max())) ** 4))


@cause("geometry", (0.03, 0.6), vessels=(2.0, 4.999), pattern=(0.0, PATTERNS))
def misread_radii(case: Case, size: float, *, vessels: float, pattern: float) -> Case:
    """A handful of vessels was measured badly.

    r_true = r exp(+-a w) in two to four vessels, w from 1/2 to 1; the others as they are.
    """
    n = len(case.network.ids)
    some = picked(np.arange(n), int(vessels), pattern)
    rng = np.random.default_rng([int(pattern), 1])
    factor = np.ones(n)
    weights = rng.choice([-1.0, 1.0], len(some)) * rng.uniform(0.5, 1.0, len(some))
    factor[some] = np.exp(size * weights)
    return _radii(case, factor)


@cause("geometry", (0.2, 3.0), power=(0.3, 1.5))
def tortuous_vessels(case: Case, size: float, *, power: float) -> Case:
    """Lengths are those of straight lines; vessels wind, the narrow ones more.

    L_true = L (1 + a (1 - r/r_root)^m): the narrower, the more tortuous.
    """
    case = with_true_lengths(case)
    radius = case.network.radius_in_cm
    factor = 1 + size * (1 - radius / radius.max() + 1e-12) ** power
    return with_network(case, length_cm=case.network.length_cm * factor)


# -- sensors ---------------------------------------------------------------------------------------------


BEATS = 3
"""Beats after which a reading that depends on its past repeats."""


def _on_pressures(wave: Wave, changed: Array) -> Wave:
    return replace(wave, value=np.where(wave.is_pressure[:, None], changed, wave.value))


def _bubble(omega: Array, *, period_s: float, damping: float, lag: float) -> NDArray[Any]:
    ratio = omega * period_s / (2 * np.pi)
    return np.asarray(1 / ((1 + 1j * lag * ratio) * (1 - ratio**2 + 2j * damping * ratio)))


def _echo(omega: Array, *, size: float, delay_s: float) -> NDArray[Any]:
    return np.asarray((1 + size * np.exp(-1j * omega * delay_s)) / (1 + size))


def _through(wave: Wave, *, response: Any) -> Wave:
    return _on_pressures(wave, filtered(wave.value, wave.period_s, response))


def _saturated(wave: Wave, *, size: float, share: float) -> Wave:
    low = wave.value.min(axis=1, keepdims=True)
    knee = low + share * (wave.value.max(axis=1, keepdims=True) - low)
    over = np.maximum(wave.value - knee, 0.0)
    return _on_pressures(wave, np.where(over > 0, knee + np.tanh(size * over) / size, wave.value))


def _sticking(wave: Wave, *, size: float, travel: float) -> Wave:
    value = wave.value
    steps = np.roll(value, -1, axis=1) - value
    side, kept = np.sign(steps), np.exp(-np.abs(steps) / travel)
    z = np.zeros_like(value)
    now = np.zeros(len(value))
    for _ in range(BEATS):
        for i in range(value.shape[1]):
            z[:, i] = now
            now = side[:, i] + (now - side[:, i]) * kept[:, i]
    return _on_pressures(wave, value - size * z)


@cause("sensor", (0.003, 0.04), damping=(0.08, 0.4), lag=(0.3, 1.5))
def bubbly_catheter(case: Case, size: float, *, damping: float, lag: float) -> Case:
    """An underdamped catheter behind an air bubble: third order, ringing and late.

    H = 1/((1 + i w b/w_n)(1 - (w/w_n)^2 + 2 i z w/w_n)), w_n = 2 pi/size; a in s.
    """
    response = functools.partial(_bubble, period_s=size, damping=damping, lag=lag)
    return with_wave(case, functools.partial(_through, response=response))


@cause("sensor", (0.03, 0.9), delay=(0.004, 0.02))
def catheter_echo(case: Case, size: float, *, delay: float) -> Case:
    """What the far end of the line sends back is read once more, some ms later.

    y(t) = (p(t) + a p(t - d))/(1 + a).
    """
    response = functools.partial(_echo, size=size, delay_s=delay)
    return with_wave(case, functools.partial(_through, response=response))


@cause("sensor", (0.01, 0.4), share=(0.0, 0.5))
def soft_saturation(case: Case, size: float, *, share: float) -> Case:
    """The transducer reads high pressures too low.

    y = k + tanh(a (p - k))/a above k, a part of the pulse above its foot; a in 1/mmHg.
    """
    return with_wave(case, functools.partial(_saturated, size=size, share=share))


@cause("sensor", (0.03, 1.5), travel=(0.3, 4.0))
def sticking_transducer(case: Case, size: float, *, travel: float) -> Case:
    """The reading lags behind by an amount of pressure, as with friction.

    y = p - a z, dz = (sign(dp) - z) |dp|/d: a lag of the amplitude, whatever the rate; a in mmHg. Dahl
    1968, A solid friction model
    """
    return with_wave(case, functools.partial(_sticking, size=size, travel=travel))


COMPONENTS = tuple(dict.fromkeys(one.component for one in CAUSES.values()))
"""Of the simulator, in which a cause may lie."""


def of_component(component: str) -> tuple[Cause, ...]:
    """The causes of a component."""
    return tuple(one for one in CAUSES.values() if one.component == component)
