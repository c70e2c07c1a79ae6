"""Free functions of components, and forward models whose discretisation is kept."""

from __future__ import annotations

import numpy as np
import pytest

from zoo.core.components import ComponentError, FreeFunction
from zoo.core.effects import with_effects
from zoo.core.forward import FunctionModel, Outputs, pinned
from zoo.core.parameters import Normal, Parameter


def shift(configuration, values):
    return {**configuration, "added": configuration.get("added", 0.0) + values}


def ramp(**changed):
    given = {"name": "push", "component": "inflow", "at": np.arange(6.0), "size": 0.5, "apply": shift}
    return FreeFunction(**(given | changed))


@pytest.mark.parametrize(("length", "period"), [(None, None), (1.3, None), (1.3, 6.0)])
def test_the_root_gives_back_the_correlation(length, period):
    function = ramp(period=period)
    root = function.root(length)
    np.testing.assert_allclose(root @ root.T, function.correlation(length), atol=1e-8)
    assert np.linalg.matrix_rank(root) == root.shape[1]


def test_a_periodic_argument_ends_where_it_begins():
    R = ramp(at=np.linspace(0.0, 6.0, 7), period=6.0).correlation(1.0)
    assert R[0, -1] == pytest.approx(1.0)
    assert R[0, 1] == pytest.approx(R[0, 5])


def test_as_an_effect_its_weights_are_standard_normal_and_move_the_values_by_sd_and_root():
    function = ramp()
    time = np.linspace(0.0, 1.0, 6)
    parameter = Parameter("a", Normal(0.0, 1.0))
    model = FunctionModel(
        lambda c, at: (c["a"] + c.get("added", np.zeros(6)))[None, :],
        (parameter,),
        Outputs(("y",), time),
        "flat",
    )
    added = function.effect(0.5, 1.3)
    both = with_effects(model, [added])
    assert [p.prior.sd for p in both.parameters[1:]] == [1.0] * (len(both.parameters) - 1)
    z = np.arange(1.0, len(both.parameters))
    np.testing.assert_allclose(
        both.solve(both.configure(np.concatenate([[2.0], z])))[0], 2.0 + 0.5 * function.root(1.3) @ z
    )
    # the first weight alone may be 0
    z[0] = 0.0
    np.testing.assert_allclose(
        both.solve(both.configure(np.concatenate([[2.0], z])))[0], 2.0 + 0.5 * function.root(1.3) @ z
    )


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({"at": np.array([0.0, np.nan])}, "at"),
        ({"size": 0.0}, "size"),
        ({"lengths": (0.0,)}, "lengths"),
        ({"labels": ("one",)}, "labels"),
    ],
)
def test_pieces_that_do_not_fit_are_named(changed, text):
    with pytest.raises(ComponentError, match=text):
        ramp(**changed)


def test_a_pinned_model_takes_the_same_steps_whatever_the_stiffness():
    from zoo.blood.baseline import get_baseline
    from zoo.blood.study import load_study

    model = get_baseline("linear-constant").forward(load_study("demo"))
    start = np.array([4.5e4, 1.0, 1.0, 1.0])
    fixed = pinned(model, model.configure(start))
    assert fixed.options.steps_per_beat > 0 == model.options.steps_per_beat

    # differences are those of one smooth function: halving the step changes a quotient little
    def quotient(which, step):
        moved = start * [1.0 + step, 1.0, 1.0, 1.0]
        return (which.solve(which.configure(moved)) - which.solve(which.configure(start))) / step

    near, far = quotient(fixed, 1e-3), quotient(fixed, 2e-3)
    assert np.abs(far - near).max() < 0.02 * np.abs(near).max()


def test_what_has_no_discretisation_is_pinned_as_it_is():
    model = FunctionModel(lambda c, at: at[None, :], (), Outputs(("y",), np.arange(3.0)), "line")
    assert pinned(model, None) is model
