"""Modes of the posterior of model F on the measured mouse."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from zoo.blood.study import Study

MODES: dict[str, dict[str, float | list[float]]] = {
    "highest": {
        "m_chi": 65900.0,
        "v_chi": 73.6,
        "chi": [
            49350, 31340, 65470, 22640, 138700, 212900, 147000, 14160, 158800, 57680, 1512, 2291,
            123400, 152000, 165100, 151400, 11990, 252300, 163200, 183900, 141000,
        ],
        "psi1": 2.358,
        "psi2": 0.1676,
        "c": 0.0709,
        "sigma2": 0.0358,
    },
    "published": {
        "m_chi": 59500.0,
        "v_chi": 5.46,
        "chi": [
            50970, 40100, 55470, 23340, 70020, 94460, 71780, 5416, 66520, 81120, 66720, 2998,
            67710, 80260, 63340, 73040, 25590, 81850, 83170, 71760, 72930,
        ],
        "psi1": 2.461,
        "psi2": 0.238,
        "c": 2.102,
        "sigma2": 0.047,
    },
    "prior": {
        "m_chi": 47900.0,
        "v_chi": 2.17,
        "chi": [
            48060, 44240, 61910, 29480, 54460, 63670, 56290, 15180, 55430, 4857, 51230, 50390,
            51440, 48530, 55020, 42900, 49810, 47200, 47100, 62730, 54810,
        ],
        "psi1": 1.557,
        "psi2": 0.552,
        "c": 2.395,
        "sigma2": 0.0506,
    },
}  # fmt: skip
"""Where searches ended: from the highest draw of chains on an earlier reduction of the record, from a search
whose psi1 and psi2 were held in the published 95 % intervals, and from 16 draws of the prior; g cm-1 s-2,
mmHg2. The searches are not repeated here, and nothing says that there is no higher mode."""


def start_of(name: str, study: Study) -> Mapping[str, Any] | None:
    """Where the search for the posterior of a model begins on the measured mouse; None for its own start.

    Only F has one: the highest of its modes that is known, which a search from the prior does not find.
    """
    vessels = len(MODES["highest"]["chi"])  # type: ignore[arg-type]
    return MODES["highest"] if (name, study.name, len(study.vessels)) == ("F", "mouse-c6", vessels) else None
