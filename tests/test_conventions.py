"""Named readings of the equations, and their switches."""

import math
import pickle
from dataclasses import replace

import pytest

from zoo.blood.conventions import (
    NAMES,
    PRINTED,
    PUBLISHED_CODE,
    Conventions,
    ConventionsError,
    get_conventions,
)
from zoo.blood.units import MMHG, cgs_to_mmhg, mmhg_to_cgs


def test_units() -> None:
    """Standard gravity times the density of mercury, 13.5951 g/cm3, times 0.1 cm, to the printed digits."""
    assert pytest.approx(980.665 * 13.5951 * 0.1, abs=0.01) == MMHG
    assert mmhg_to_cgs(2.0) == 2 * 1333.22
    assert cgs_to_mmhg(1332.22, 1332.22) == 1.0
    assert cgs_to_mmhg(mmhg_to_cgs(17.3)) == pytest.approx(17.3, rel=1e-15)


def test_the_two_bundles_differ_in_what_the_published_code_does() -> None:
    assert PRINTED == Conventions() == get_conventions("printed")
    assert PUBLISHED_CODE == get_conventions("published-code")
    assert NAMES == ("printed", "published-code")
    assert (PRINTED.mmhg, PUBLISHED_CODE.mmhg) == (MMHG, 1332.22)
    assert PUBLISHED_CODE.wall_factor * math.pi == pytest.approx(1)
    assert PUBLISHED_CODE.stiffness_radius_unit_cm == 0.1
    assert (PUBLISHED_CODE.friction, PUBLISHED_CODE.friction_radius_cm) == ("fixed", 0.07)
    assert PUBLISHED_CODE.truncate_lengths is True
    assert (PRINTED.sample_lag_beats, PUBLISHED_CODE.sample_lag_beats) == (0.0, 1 / 512)
    assert PRINTED.truncate_lengths is False
    assert not PRINTED.changes
    assert not PUBLISHED_CODE.changes


def test_a_changed_bundle_says_so() -> None:
    own = PUBLISHED_CODE.replace(friction="current")
    assert own.name == "custom (published-code with friction=current)"
    assert own.base == "published-code"
    assert own.changes == {"friction": "current"}
    assert own.wall_factor == PUBLISHED_CODE.wall_factor
    further = own.replace(mmhg=1333.22)
    assert further.name == "custom (published-code with friction=current, mmhg=1333.22)"
    assert further.replace(friction="fixed", mmhg=1332.22) == PUBLISHED_CODE
    assert replace(PRINTED, friction="rest").name == "custom (printed with friction=rest)"
    assert replace(own, friction="fixed").name == "published-code"
    assert Conventions("custom", friction="rest") == PRINTED.replace(friction="rest")
    assert pickle.loads(pickle.dumps(own)) == own


def test_table() -> None:
    assert get_conventions({"base": "published-code", "friction": "current"}) == PUBLISHED_CODE.replace(
        friction="current"
    )
    assert get_conventions({"friction": "rest"}) == PRINTED.replace(friction="rest")
    assert get_conventions({}) == PRINTED
    assert get_conventions(PUBLISHED_CODE) is PUBLISHED_CODE


@pytest.mark.parametrize(
    ("which", "message"),
    [
        ("publised-code", r"name = 'publised-code': unknown; did you mean 'published-code'\? use one of"),
        ({"fricton": "rest"}, r"switch = 'fricton': unknown; did you mean 'friction'\?"),
        ({"friction": "curent"}, "friction = 'curent': unknown; use one of current, rest, fixed"),
        ({"wall_factor": 0}, "wall_factor = 0: must be a number between 1e-30 and 1e"),
        ({"mmhg": math.inf}, "mmhg = inf"),
        ({"mmhg": True}, "mmhg = True"),
        ({"truncate_lengths": 1}, "truncate_lengths = 1: not a switch; use true or false"),
        ({"sample_lag_beats": 1.5}, r"sample_lag_beats = 1\.5: not a part of a beat; use a number between"),
    ],
)
def test_mistakes_are_named(which: object, message: str) -> None:
    with pytest.raises(ConventionsError, match=message) as error:
        get_conventions(which)  # type: ignore[arg-type]
    assert "\n" not in str(error.value)
