"""Options that change the physics of a study for one solve: walls, profile, junctions, outlets, pressures."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zoo.cli.checks import numbers
from zoo.cli.command import UsageError

if TYPE_CHECKING:
    from zoo.blood.study import Study

_PER_VESSEL = {
    "stiffness_out": "stiffness_out_g_cm_s2",
    "youngs_modulus": "youngs_modulus_g_cm_s2",
    "wall_thickness": "wall_thickness_cm",
    "wall_thickness_out": "wall_thickness_out_cm",
    "outflow_pressure": "outflow_pressure_mmHg",
    "external_pressure": "external_pressure_mmHg",
    "radius_pressure": "radius_pressure_mmHg",
}
"""Options with one value, or one for each vessel, and the fields that they set."""
_STIFFNESS = ("stiffness_g_cm_s2", "stiffness_out_g_cm_s2")
_MODULUS = ("youngs_modulus_g_cm_s2", "wall_thickness_cm", "wall_thickness_out_cm")


@dataclass(frozen=True)
class PhysicsOptions:
    """What takes the place of a study's own physics; one value, or one per vessel, where these differ."""

    stiffness_out: Annotated[
        str | None,
        typer.Option("--stiffness-out", help="chi at the outlets, linear from --stiffness at the inlets."),
    ] = None
    youngs_modulus: Annotated[
        str | None,
        typer.Option("--youngs-modulus", help="E, g/(cm s2), with --wall-thickness: chi = E h/r."),
    ] = None
    wall_thickness: Annotated[
        str | None, typer.Option("--wall-thickness", help="h, cm: one value, or one per vessel.")
    ] = None
    wall_thickness_out: Annotated[
        str | None, typer.Option("--wall-thickness-out", help="h at the outlets, cm, linear between.")
    ] = None
    velocity_profile_order: Annotated[
        str | None,
        typer.Option(
            "--velocity-profile-order",
            help="zeta in the friction -2 (zeta + 2) pi nu q/A, or flat, eq. (3.1).",
        ),
    ] = None
    momentum_correction: Annotated[
        float | None, typer.Option("--momentum-correction", help="Factor of q^2/A, 1 or more.")
    ] = None
    junctions: Annotated[
        str | None, typer.Option("--junctions", help="static or total pressure, equal where vessels meet.")
    ] = None
    resistance: Annotated[
        str | None,
        typer.Option("--resistance", help="Single resistances as outlets, dyn s/cm5."),
    ] = None
    outflow_pressure: Annotated[
        str | None,
        typer.Option("--outflow-pressure", help="Behind the outlets, mmHg."),
    ] = None
    external_pressure: Annotated[
        str | None,
        typer.Option("--external-pressure", help="Outside the vessels, mmHg."),
    ] = None
    radius_pressure: Annotated[
        str | None,
        typer.Option("--radius-pressure", help="At which radii are given, mmHg."),
    ] = None

    def applied(self, study: Study, stiffness: list[float] | None) -> Study:
        """The study with these in the place of its own, and with stiffnesses of its vessels if given."""
        from zoo.blood.study import JUNCTION_PRESSURES, check_physics

        if stiffness is None and self.stiffness_out is not None:
            raise UsageError("--stiffness-out belongs to --stiffness, the value at the inlets: add that")
        if stiffness is not None and self.youngs_modulus is not None:
            raise UsageError("--stiffness and --youngs-modulus say the same: give one of them")
        if (self.youngs_modulus is None) != (self.wall_thickness is None):
            raise UsageError("--youngs-modulus and --wall-thickness belong together: give both")
        whole: dict[str, Any] = {}
        if self.junctions is not None:
            if self.junctions not in JUNCTION_PRESSURES:
                raise UsageError(f"--junctions {self.junctions}: use one of {', '.join(JUNCTION_PRESSURES)}")
            whole["junction_pressure"] = self.junctions
        blood = study.blood
        if self.velocity_profile_order is not None:
            blood = replace(blood, velocity_profile_order=_order(self.velocity_profile_order))
        if self.momentum_correction is not None:
            if not self.momentum_correction >= 1:
                raise UsageError(f"--momentum-correction {self.momentum_correction}: must be at least 1")
            blood = replace(blood, momentum_correction=self.momentum_correction)
        changes = self._of_vessels(study, stiffness)
        vessels = tuple(replace(v, **change) for v, change in zip(study.vessels, changes, strict=True))
        check_physics(vessels, radius_pressure_mmHg=study.radius_pressure_mmHg)
        return replace(study, vessels=vessels, blood=blood, **whole)

    def _of_vessels(self, study: Study, stiffness: list[float] | None) -> list[dict[str, Any]]:
        """Fields of each vessel that change."""
        n = len(study.vessels)
        feeding = {v.parent for v in study.vessels}
        changes: list[dict[str, Any]] = [{} for _ in study.vessels]
        if stiffness is not None or self.youngs_modulus is not None:
            for change in changes:
                change |= dict.fromkeys((*_STIFFNESS, *_MODULUS))
        if stiffness is not None:
            for change, value in zip(changes, stiffness, strict=True):
                change["stiffness_g_cm_s2"] = value
        for option, field in _PER_VESSEL.items():
            text = getattr(self, option)
            if text is None:
                continue
            values = numbers("--" + option.replace("_", "-"), text, study)
            for i, change in enumerate(changes):
                if option != "outflow_pressure" or study.vessels[i].id not in feeding:
                    change[field] = values[i % len(values)]
        if self.resistance is not None:
            values = numbers("--resistance", self.resistance, study)
            for i in range(n):
                if study.vessels[i].id not in feeding:
                    changes[i] |= {"resistance": values[i % len(values)], "windkessel": None}
        return changes


def _order(text: str) -> float | None:
    if text == "flat":
        return None
    try:
        order = float(text)
    except ValueError:
        order = 0.0
    if not 0 < order < float("inf"):
        raise UsageError(f"--velocity-profile-order {text}: give a positive number, such as 9, or flat")
    return order
