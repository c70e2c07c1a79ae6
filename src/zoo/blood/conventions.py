"""How the equations are read: as the paper prints them, or as the authors' public code runs them.

The two differ in seven places, each a switch of its own. The code's slip in the tangent wall's flux
(only a part of it is divided by the squared Froude number) is not among them: it is not reproduced.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from zoo.core.arrays import real_number
from zoo.core.words import OneLineError, nearest, short

FRICTIONS = ("current", "rest", "fixed")
_LEAST = 1e-30


class ConventionsError(OneLineError, ValueError):
    """A convention that does not exist, or a value that it cannot take."""


@dataclass(frozen=True)
class Conventions:
    """One reading of eq. (3.1)-(3.7), as a bundle of switches.

    Linear wall p = (4/3) chi (sqrt(A/A0) - 1) in both; tangent wall p = k chi tan(pi/gamma (A/A0 - 1));
    chi = f1 exp(f2 r0/u) + f3; friction -(2 pi mu r/(rho delta)) q/A.

    Parameters
    ----------
    name : str
        "printed", "published-code", or "custom (BASE with SWITCH=VALUE, ...)"; it always follows from
        the switches, so a changed copy of a bundle never keeps the bundle's name.
    wall_factor : float
        k, dimensionless; 1/pi in the published code.
    stiffness_radius_unit_cm : float
        u, cm; 0.1 in the published code.
    friction : {"current", "rest", "fixed"}
        The radius r: sqrt(A/pi), r0, or the same for every vessel.
    friction_radius_cm : float
        That one radius, cm; read with ``friction="fixed"`` only.
    truncate_lengths : bool
        Vessels of int(40 L) cells of 0.025 cm instead of their true length L.
    mmhg : float
        dyn/cm2 in 1 mmHg.
    sample_lag_beats : float
        The model is compared with a sample this part of a beat after the sample's time. The published
        program writes row k after step 16 (k + 1) of 8192, so row k is 1/512 of a beat later than sample k of
        512, which it is compared with. Docs: conventions.

    Raises
    ------
    ConventionsError
        If a value is out of range.

    References
    ----------
    Paun et al. 2020, doi 10.1098/rsif.2020.0886; its public code, repository LMihaelaP/ModelMismatchPaper.
    """

    name: str = "printed"
    wall_factor: float = 1.0
    stiffness_radius_unit_cm: float = 1.0
    friction: str = "current"
    friction_radius_cm: float = 0.07
    truncate_lengths: bool = False
    mmhg: float = 1333.22
    sample_lag_beats: float = 0.0

    def __post_init__(self) -> None:
        for switch in ("wall_factor", "stiffness_radius_unit_cm", "friction_radius_cm", "mmhg"):
            given, words = getattr(self, switch), f"a number between {_LEAST:g} and {1 / _LEAST:g}"
            value = real_number(f"conventions: {switch}", given, words, error=ConventionsError)
            if not _LEAST <= value <= 1 / _LEAST:
                raise ConventionsError(f"conventions: {switch} = {short(given)}: must be {words}; correct it")
            object.__setattr__(self, switch, value)
        if not isinstance(self.sample_lag_beats, (int, float)) or not abs(self.sample_lag_beats) < 1:
            raise ConventionsError(
                f"conventions: sample_lag_beats = {short(self.sample_lag_beats)}: not a part of a beat; "
                "use a number between -1 and 1"
            )
        if self.friction not in FRICTIONS:
            raise ConventionsError(
                f"conventions: friction = {short(self.friction)}: unknown; use one of {', '.join(FRICTIONS)}"
            )
        if not isinstance(self.truncate_lengths, bool):
            raise ConventionsError(
                f"conventions: truncate_lengths = {short(self.truncate_lengths)}: not a switch; use true or "
                "false"
            )
        base = self.base
        changed = [f"{s}={getattr(self, s)}" for s in SWITCHES if getattr(self, s) != _VALUES[base][s]]
        object.__setattr__(self, "name", f"custom ({base} with {', '.join(changed)})" if changed else base)

    @property
    def base(self) -> str:
        """Name of the bundle that these switches started from."""
        words = self.name.removeprefix("custom").strip(" ()").split(" with ")[0] or "printed"
        if words not in _VALUES:
            raise ConventionsError(_unknown("name", self.name, _VALUES))
        return words

    @property
    def changes(self) -> dict[str, Any]:
        """Switches that differ from the base, by name."""
        base = _VALUES[self.base]
        return {s: getattr(self, s) for s in SWITCHES if getattr(self, s) != base[s]}

    def replace(self, **switches: Any) -> Conventions:
        """These conventions with some switches changed; the name says which.

        Parameters
        ----------
        **switches
            Fields other than ``name``.

        Returns
        -------
        Conventions

        Raises
        ------
        ConventionsError
            If a switch does not exist or a value is out of range.
        """
        for switch in switches:
            if switch not in SWITCHES:
                raise ConventionsError(_unknown("switch", switch, SWITCHES))
        values = {s: getattr(self, s) for s in SWITCHES}
        return Conventions(name=self.base, **(values | switches))


def _unknown(what: str, value: object, known: Any) -> str:
    return f"conventions: {what} = {short(value)}: {nearest(value, list(known))}"


SWITCHES = tuple(f.name for f in fields(Conventions) if f.name != "name")
_VALUES: dict[str, dict[str, Any]] = {
    "printed": {f.name: f.default for f in fields(Conventions) if f.name != "name"},
    "published-code": {
        "wall_factor": 1 / math.pi,
        "stiffness_radius_unit_cm": 0.1,
        "friction": "fixed",
        "friction_radius_cm": 0.07,
        "truncate_lengths": True,
        "mmhg": 1332.22,
        "sample_lag_beats": 1 / 512,
    },
}

PRINTED = Conventions()
"""The paper's equations and true vessel lengths; the default of a new study."""
PUBLISHED_CODE = Conventions("published-code", **_VALUES["published-code"])
"""What the authors' public code runs; the built-in study ``mouse-c6`` uses it."""
NAMES = tuple(_VALUES)


def get_conventions(which: str | Mapping[str, Any] | Conventions) -> Conventions:
    """Conventions by name, or from a table with a base and changed switches.

    Parameters
    ----------
    which : str, mapping or Conventions
        "printed", "published-code"; ``{"base": NAME, SWITCH: VALUE, ...}``, where the base is "printed"
        when absent; or conventions, handed back as they are.

    Returns
    -------
    Conventions

    Raises
    ------
    ConventionsError
        If a name or a switch does not exist, or a value is out of range.
    """
    if isinstance(which, Conventions):
        return which
    if isinstance(which, Mapping):
        switches = dict(which)
        base = switches.pop("base", "printed")
        if not isinstance(base, str):
            raise ConventionsError(_unknown("base", base, _VALUES))
        return get_conventions(base).replace(**switches)
    if not isinstance(which, str) or which not in _VALUES:
        raise ConventionsError(_unknown("name", which, _VALUES))
    return Conventions(which, **_VALUES[which])
