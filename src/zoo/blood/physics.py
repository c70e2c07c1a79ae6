"""What is added to the equations of blood flow inside the solver, as one value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np

from zoo.blood.functions import (
    FrictionFunction,
    JunctionFunction,
    KnotFunction,
    OutletFunction,
    WallFunction,
)
from zoo.blood.network import Network
from zoo.blood.outlet_tables import StructuredTree
from zoo.blood.solve_errors import SolverArgumentError
from zoo.blood.study import ReadOnlyArrays, Study, Vessel, read_only
from zoo.blood.units import mmhg_to_cgs
from zoo.core.arrays import Array, real_array, real_number, refuse_where, shown

_SECTIONS = "(n_vessels, n_sections)"


def _term(
    words: str,
    default: float | None = None,
    *,
    low: float = -np.inf,
    above: float = -np.inf,
    high: float = np.inf,
    shape: str = "(n_vessels,)",
) -> Any:
    """A number, or an array of a shape whose default is None: what its values must be."""
    told = {"words": words, "low": low, "above": above, "high": high, "shape": shape}
    return field(default=default, metadata=told)


@dataclass(frozen=True, eq=False)
class Physics(ReadOnlyArrays):
    """What is added to eq. (3.1) to (3.7); the default is nothing. Read-only.

    Arrays have one value per vessel, in the order of ``Network.ids``, except `stiffness_wave`; None stands
    for no change.

    Parameters
    ----------
    momentum_correction : float
        alpha, factor of q^2/A; 1 for a flat profile.
    stokes_friction : float
        Factor of the Stokes layer's friction, eq. (3.1); 0 switches it off.
    viscous_friction : float
        k in a further friction -k pi nu q/A; 8 is Poiseuille's, 2 (zeta + 2) that of a profile of order zeta.
    viscosity_factor : array (n_vessels,)
        Factor of the viscosity in each vessel, in both frictions and in delta.
    offset_in, offset_out : array (n_vessels,)
        dyn/cm2, added to the wall's pressure at the inlet and outlet, linear between: an external pressure
        or a hydrostatic head. Given alone, the other is zero.
    stiffness_ratio, stiffness_exponent : array (n_vessels,)
        s and e in chi(x) = chi (1 + (s - 1) x/L) (r0(0)/r0(x))^e, the stiffness along each vessel: e = 1
        where the wall's E h is constant, s = h(L)/h(0) with it where the wall's thickness changes.
    viscoelastic_time : array (n_vessels,)
        tau, s, in p = p_e + tau dp_e/dt with the wall's p_e (Kelvin-Voigt), slowed by `relaxation_time`.
    relaxation_time : float
        tau_r, s: p = p_e + p_v, tau_r dp_v/dt + p_v = tau dp_e/dt (Zener; Kelvin-Voigt as tau_r goes to 0).
    stiffness_wave : array (m,)
        s, factor of the stiffness in all vessels at m uniform times of the beat from 0, linear between,
        periodic: p_e = s(t) wall(A), for walls that stiffen and soften by themselves.
    leak : array (n_vessels,)
        cm4 s/g (ml/s per dyn/cm2 and cm): A_t + q_x = -leak p. What leaves takes its axial momentum along.
    total_pressure : float
        tau: at a junction p + tau rho u^2/2 is shared instead of p, u = q/A at the branch's own end.
    junction_loss : float
        K: each daughter's inlet has K rho/2 u abs(u) less pressure than the parent's end, u the parent's.
    outflow_pressure : array (n_vessels,)
        p_out, dyn/cm2, read at terminals: behind the outlets, p - p_out = R1 q + v.
    outflow_wave : array (n_vessels, n_times)
        f, dyn/cm2, read at terminals: what is added to the pressure behind the outlets at uniform times of
        the beat from 0, linear between, periodic. It acts behind the resistances, as compliances rest on the
        tissue: C_k dv_k/dt = q - (v_k - s_k f)/R_k with s_k = R_k/sum R, so that without flow an outlet has
        f sum_k s_k/(1 + i w R_k C_k) in front of it; f itself where it is a single resistance.
    inertance : array (n_vessels,)
        L, g/cm4, read at terminals: p = v + R1 q + p_L, p_L = L dq_L/dt = R_p (q - q_L), where R_p is
        6 rho c/A0 of the terminal's end at rest and lets out waves faster than R_p/L (6 c/l at rho l/A0),
        without which they would grow.
    section_resistance, section_compliance : array (n_vessels, n_sections)
        Shares rho_k and kappa_k, read at terminals: R1 in series with parallel pairs R_k, C_k (Foster's
        form), R_k = rho_k psi2 R2, C_k = kappa_k c C, C_k dv_k/dt = q - v_k/R_k, p = R1 q + sum_k v_k.
        One section of (1, 1) is the Windkessel; one with rho_k = 0 is absent. Given together. The sum of a
        terminal's rho_k is positive; single sections may be negative, rho_k < 0 with kappa_k < 0, as long as
        R1 is larger than all of these together: then the impedance's real part is positive at every
        frequency.
    throat_severity : array (n_vessels,)
        s in [0, 1): the radius at rest is multiplied by 1 - s (1 + cos(2 pi (x - x0)/l))/2 for
        abs(x - x0) < l/2.
    throat_position : array (n_vessels,)
        x0/L; 0.5 when not given.
    throat_length : array (n_vessels,)
        l, cm; 0.15 when not given.
    throat_loss : float
        K_t: over the throat, pressure falls by a further K_t rho/2 (A0/A0_throat - 1)^2 (q/A0)^2, A0 the
        area at rest without the throat, A0_throat at its narrowest.
    loss_quadratic, loss_linear : array (n_vessels,)
        a, g/cm7, and b, dyn s/cm5: along a stretch, pressure falls by a q abs(q) + b q (A0/A)^2, A0 the area
        at rest, beside what the vessel loses without it; its radius stays.
    loss_position, loss_length : array (n_vessels,)
        Middle of the stretch, 0 to 1, and its length, cm. Given together with a loss.
    wall_function : WallFunction
        delta(s) in p = K (law(A/A0) + delta(sqrt(A/A0))), one function for all vessels, K each vessel's own.
    friction_function : FrictionFunction
        phi(abs(u)), factor of both frictions, one function for all vessels.
    junction_function : JunctionFunction
        D(u): each daughter's inlet has D(u) less pressure than the parent's end, u the parent's, beside what
        `junction_loss` takes.
    outlet_resistance_function, outlet_compliance_function : OutletFunction
        Logarithm of a factor of the resistances and compliances of all outlets' sections at the pressure v
        (dyn/cm2) behind R1; C is dV/dv. Functions whose values are all nothing (0, or 1 as the factor of
        friction) are as if not given.

    Raises
    ------
    SolverArgumentError
        If a value is out of range.

    References
    ----------
    Young and Tsai 1973, doi 10.1016/0021-9290(73)90099-7.
    """

    momentum_correction: float = _term("positive; 1 is a flat profile, 4/3 a parabolic one", 1.0, above=0.0)
    stokes_friction: float = _term("zero or positive; 1 is eq. (3.1)", 1.0, low=0.0)
    viscous_friction: float = _term("zero or positive; 8 is Poiseuille's", 0.0, low=0.0)
    viscosity_factor: Array | None = _term("positive", above=0.0)
    offset_in: Array | None = _term("finite, dyn/cm2")
    offset_out: Array | None = _term("finite, dyn/cm2")
    stiffness_ratio: Array | None = _term("positive", above=0.0)
    stiffness_exponent: Array | None = _term("finite")
    viscoelastic_time: Array | None = _term("zero or positive, s", low=0.0)
    relaxation_time: float = _term("positive, s", 3e-4, above=0.0)
    stiffness_wave: Array | None = _term("positive", above=0.0, shape="(n_times,)")
    leak: Array | None = _term("zero or positive, cm4 s/g", low=0.0)
    total_pressure: float = _term("zero or positive; 1 is the total pressure", 0.0, low=0.0)
    junction_loss: float = _term("zero or positive", 0.0, low=0.0)
    outflow_pressure: Array | None = _term("finite, dyn/cm2")
    outflow_wave: Array | None = _term("finite, dyn/cm2", shape="(n_vessels, n_times)")
    inertance: Array | None = _term(
        "zero or positive, g/cm4; any value, say 0, where a vessel is no terminal", low=0.0
    )
    section_resistance: Array | None = _term("finite", shape=_SECTIONS)
    section_compliance: Array | None = _term("finite", shape=_SECTIONS)
    throat_severity: Array | None = _term("at least 0 and below 1", low=0.0, high=1.0 - 1e-9)
    throat_position: Array | None = _term("between 0 (inlet) and 1 (outlet)", low=0.0, high=1.0)
    throat_length: Array | None = _term("positive, cm", above=0.0)
    throat_loss: float = _term("zero or positive; Young and Tsai have 1.52", 1.52, low=0.0)
    loss_quadratic: Array | None = _term("zero or positive, g/cm7", low=0.0)
    loss_linear: Array | None = _term("zero or positive, dyn s/cm5", low=0.0)
    loss_position: Array | None = _term("between 0 (inlet) and 1 (outlet)", low=0.0, high=1.0)
    loss_length: Array | None = _term("positive, cm", above=0.0)
    wall_function: WallFunction | None = field(default=None, metadata={"kind": WallFunction})
    friction_function: FrictionFunction | None = field(default=None, metadata={"kind": FrictionFunction})
    junction_function: JunctionFunction | None = field(default=None, metadata={"kind": JunctionFunction})
    outlet_resistance_function: OutletFunction | None = field(default=None, metadata={"kind": OutletFunction})
    outlet_compliance_function: OutletFunction | None = field(default=None, metadata={"kind": OutletFunction})

    def __post_init__(self) -> None:
        for one in fields(self):
            name, given, told = one.name, getattr(self, one.name), one.metadata
            if "kind" in told:
                if not (given is None or isinstance(given, told["kind"])):
                    kind = told["kind"].__name__
                    raise SolverArgumentError(
                        f"physics: {name} = {shown(given)}: must be a {kind}(low, high, values)"
                    )
            elif one.default is not None:
                value = real_number(f"physics: {name}", given, told["words"], error=SolverArgumentError)
                if value < told["low"] or value <= told["above"]:
                    raise SolverArgumentError(f"physics: {name} = {value}: must be {told['words']}")
                object.__setattr__(self, name, value)
            elif given is not None:
                object.__setattr__(self, name, self._checked(name, given, told))
        loses = self.loss_quadratic is not None or self.loss_linear is not None
        if loses and (self.loss_position is None or self.loss_length is None):
            raise SolverArgumentError("physics: loss_position and loss_length must be given with a loss")
        if (self.section_resistance is None) != (self.section_compliance is None):
            raise SolverArgumentError(
                "physics: section_resistance and section_compliance must be given together"
            )
        if self.section_resistance is not None and self.section_compliance is not None:
            if self.section_resistance.shape != self.section_compliance.shape:
                raise SolverArgumentError(
                    f"physics: section_compliance has shape {self.section_compliance.shape}: must be that of "
                    f"section_resistance, {self.section_resistance.shape}"
                )
            there = self.section_resistance != 0
            lacking = there & ~(np.sign(self.section_resistance) == np.sign(self.section_compliance))
            if lacking.any():
                vessel, section = (int(i) for i in np.argwhere(lacking)[0])
                raise SolverArgumentError(
                    f"physics: section_compliance[{vessel}, {section}] = "
                    f"{self.section_compliance[vessel, section]}: must be of the resistance's sign, "
                    f"{self.section_resistance[vessel, section]}"
                )

    @staticmethod
    def _checked(name: str, given: Any, told: Mapping[str, Any]) -> Array:
        values: Array = read_only(real_array(f"physics: {name}", given, error=SolverArgumentError))
        if values.ndim != told["shape"].count("n_") or not values.size:
            raise SolverArgumentError(f"physics: {name} has shape {values.shape}: must be {told['shape']}")
        inside = (values >= told["low"]) & (values > told["above"]) & (values <= told["high"])
        bad = ~(np.isfinite(values) & inside)
        refuse_where(f"physics: {name}", values, bad, told["words"], error=SolverArgumentError)
        return values

    def settings(self) -> dict[str, Any]:
        """The fields that are not at their default, arrays as lists."""
        given = {}
        for one in fields(self):
            value = getattr(self, one.name)
            if isinstance(value, np.ndarray):
                given[one.name] = value.tolist()
            elif isinstance(value, KnotFunction):
                given[one.name] = {**asdict(value), "values": list(value.values)}
            elif value != one.default:
                given[one.name] = value
        return given

    def fit(self, network: Network) -> None:
        """Raise SolverArgumentError where an array does not fit the network."""
        n_vessels = len(network.ids)
        for one in fields(self):
            name, values = one.name, getattr(self, one.name)
            of_vessels = one.metadata.get("shape", "").startswith("(n_vessels")
            if of_vessels and one.default is None and values is not None and len(values) != n_vessels:
                raise SolverArgumentError(
                    f"physics: {name} has shape {values.shape}: must have one row per vessel, {n_vessels}"
                )
        if self.section_resistance is not None:
            for k in network.terminals:
                if not self.section_resistance[k].sum() > 0:
                    raise SolverArgumentError(
                        f"physics: section_resistance[{int(k)}] = {self.section_resistance[k].tolist()}: "
                        f"vessel {int(network.ids[k])} is a terminal and needs shares whose sum is positive"
                    )


NO_PHYSICS = Physics()


def study_physics(
    study: Study, network: Network, *, mmhg: float | None = None, along: bool = True
) -> Physics:
    """What a study adds to the equations: profile, junctions, pressures, stiffness along the vessels.

    Parameters
    ----------
    study : Study
    network : Network
        Of the study.
    mmhg : float
        dyn/cm2 in 1 mmHg; that of the study's conventions if absent.
    along : bool
        Whether stiffness changes along the vessels as the study says: chi linear between the ends, or E
        h(x)/r(x).

    Returns
    -------
    Physics
        `NO_PHYSICS` for a study that adds nothing.
    """
    unit = study.conventions.mmhg if mmhg is None else mmhg
    by_id = {v.id: v for v in study.vessels}
    vessels = [by_id[int(i)] for i in network.ids]
    given: dict[str, Any] = {}
    blood = study.blood
    if blood.velocity_profile_order is not None:
        given |= {"stokes_friction": 0.0, "viscous_friction": 2 * (blood.velocity_profile_order + 2)}
    if blood.momentum_correction != 1:
        given["momentum_correction"] = blood.momentum_correction
    if study.junction_pressure == "total":
        given["total_pressure"] = 1.0
    around = np.array(
        [study.pressure_mmHg("external", v) + study.pressure_mmHg("radius", v) for v in vessels]
    )
    if np.any(around):
        given["offset_in"] = given["offset_out"] = mmhg_to_cgs(around, unit)
    behind = np.array([study.pressure_mmHg("outflow", v) for v in vessels])
    if np.any(behind[network.terminals]):
        given["outflow_pressure"] = mmhg_to_cgs(behind, unit)
    if len(study.outflow_wave_mmHg):
        changes = study.outflow_wave_mmHg - study.outflow_pressure_mmHg
        of_study = np.array([v.outflow_pressure_mmHg is None for v in vessels])
        given["outflow_wave"] = mmhg_to_cgs(np.where(of_study[:, None], changes, 0.0), unit)
    losses = np.array([_loss(study, v) for v in vessels]).T
    if np.any(losses[:2]):
        names = ("loss_quadratic", "loss_linear", "loss_position", "loss_length")
        given |= dict(zip(names, losses, strict=True))
    if along and network.stiffness_in is not None and network.stiffness_out is not None:
        elastic = np.array([v.youngs_modulus_g_cm_s2 is not None for v in vessels])
        narrowing = network.radius_out_cm / network.radius_in_cm
        ratio = network.stiffness_out / network.stiffness_in * np.where(elastic, narrowing, 1.0)
        ratio = np.where(np.abs(ratio - 1) < 1e-12, 1.0, ratio)
        if np.any(ratio != 1):
            given["stiffness_ratio"] = ratio
        if np.any(elastic):
            given["stiffness_exponent"] = elastic.astype(np.float64)
    return Physics(**given) if given else NO_PHYSICS


def _loss(study: Study, v: Vessel) -> tuple[float, float, float, float]:
    """a, b, place and length (cm) of a vessel's stenosis; an empty stretch where there is none."""
    one = v.stenosis
    if one is None:
        return 0.0, 0.0, 0.5, v.length_cm
    at_rest = v.radius_cm + (v.radius_out_cm - v.radius_cm) * one.position
    Kt, Kv = one.constants(at_rest)
    area = np.pi * at_rest**2
    lost = study.blood.density_g_cm3 / 2 * ((at_rest / one.radius_cm) ** 2 - 1) ** 2 / area**2
    viscous = study.blood.viscosity_g_cm_s / (2 * at_rest) / area
    return Kt * lost, Kv * viscous, one.position, one.length_cm


def physics_words(study: Study) -> list[str]:
    """What `study_physics` holds, in words, one line for each part.

    Parameters
    ----------
    study : Study

    Returns
    -------
    list of str
    """
    blood, order = study.blood, study.blood.velocity_profile_order
    feeding = {v.parent for v in study.vessels}
    terminals = [v for v in study.vessels if v.id not in feeding]
    alone = sum(v.resistance is not None for v in terminals)
    trees = sum(isinstance(v.impedance, StructuredTree) for v in terminals)
    tables = sum(v.impedance is not None for v in terminals) - trees
    loads = [(len(terminals) - alone - trees - tables, "Windkessel"), (alone, "single resistance")]
    loads += [(trees, "structured tree"), (tables, "table of impedance")]
    words = [
        "flat velocity profile with a Stokes layer"
        if order is None
        else f"velocity profile of order {order:g}"
    ]
    if blood.momentum_correction != 1:
        words[0] += f", momentum correction {blood.momentum_correction:g}"
    outlets = " and ".join(f"{n} {name}{'s' * (n > 1)}" for n, name in loads if n)
    words[0] += f"; {study.junction_pressure} pressure at junctions; {outlets}"
    for name, where, vessels in (
        ("outflow", "behind the outlets", terminals),
        ("external", "outside the vessels", study.vessels),
        ("radius", "at which radii are given", study.vessels),
    ):
        found = [study.pressure_mmHg(name, v) for v in vessels]
        wave = study.outflow_wave_mmHg.tolist() if name == "outflow" else []
        if any(found) or wave:
            over = f", {_range(wave)} over the beat" if wave else ""
            words.append(f"pressure {where}: {_range(found)} mmHg{over}")
    narrow = [str(v.id) for v in study.vessels if v.stenosis is not None]
    if narrow:
        words.append(f"stenosis in vessel {', '.join(narrow)}: loss of Young and Tsai")
    if study.vessels[0].stiffness:
        source = ", E h/r" if study.vessels[0].youngs_modulus_g_cm_s2 else ""
        ends = [x for v in study.vessels for x in v.stiffness or ()]
        words.append(f"stiffness: {_range(ends)} g/(cm s2){source}")
    if study.inflow_note:
        given = "inlet pressure" if study.inlet_pressure_mmHg.size else "inflow"
        words.append(f"{given}: {study.inflow_note}")
    return words


def _range(values: Sequence[float]) -> str:
    found = f"{min(values):.4g}", f"{max(values):.4g}"
    return found[0] if found[0] == found[1] else " to ".join(found)
