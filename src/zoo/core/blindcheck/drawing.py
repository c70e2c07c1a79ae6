"""Drawing cases of a forward model: an effect, where it acts, its size, and data on another grid."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zoo.core.blindcheck.cases import BlindError
from zoo.core.derivatives import jacobian, scales_of
from zoo.core.diagnosis.coordinates import coordinates
from zoo.core.effects import AddedEffect, Effect, EffectError, with_effects
from zoo.core.forward import ForwardModel, SolveError
from zoo.core.parameters import draw_prior

Array = NDArray[np.float64]
TRIES = 60
"""Draws of an effect before giving up."""
CENTRAL = (0.025, 0.975)
STEP = 1e-3
"""Of a finite difference, over the scale of a parameter."""


@dataclass(frozen=True)
class DrawnCase:
    """Data that a simulator made, and what a diagnosis of them is not told.

    Parameters
    ----------
    data : object
        What the diagnosis is given.
    withheld : mapping
        Fields of `CaseKey`; its name, kind, label and what is accepted are added unless they are given.
    """

    data: Any
    withheld: Mapping[str, Any] = field(default_factory=dict)


class LinearBaseline:
    """A baseline around its true parameters, where it is taken for linear.

    Parameters
    ----------
    model : ForwardModel
    theta : array (n_values,)

    Attributes
    ----------
    series : array (n_series, n_times)
        Its own, without noise.
    """

    def __init__(self, model: ForwardModel, theta: ArrayLike) -> None:
        at = np.asarray(theta, dtype=np.float64)
        found = jacobian(model, at)
        if found is None:
            self.series = model.solve(model.configure(at))
            steps = STEP * scales_of(model.parameters, at)
            moved = [model.solve(model.configure(at + step)) for step in np.diag(steps)]
            slopes = np.stack([(m - self.series) / h for m, h in zip(moved, steps, strict=True)])
        else:
            self.series, slopes = found
        self.slopes = slopes

    def left(self, series: Array, scale: ArrayLike = 1.0) -> Array:
        """What it leaves when it is fitted again to noise-free series (n_series, n_times).

        Parameters
        ----------
        series : array (n_series, n_times)
        scale : array (n_series,) or float
            Standard deviations of the noise, by which the fit weighs the series.
        """
        sd = np.broadcast_to(np.asarray(scale, dtype=np.float64), len(series))[:, None]
        r, J = ((series - self.series) / sd).ravel(), (self.slopes / sd).reshape(len(self.slopes), -1).T
        size = np.linalg.norm(J, axis=0)
        J = J[:, size > 0] / size[size > 0]
        step, *_ = np.linalg.lstsq(J, r, rcond=None)
        return np.asarray((r - J @ step).reshape(series.shape) * sd)


@dataclass(frozen=True)
class ModelDraw:
    """Draws cases of a forward model: its parameters, an effect, where it acts and its size, from priors.

    Parameters
    ----------
    model : ForwardModel
        The baseline as it makes data: on a finer grid, say, than the one that is diagnosed.
    effects : sequence of Effect
        By whose names cases are asked for.
    observe : callable
        ``observe(series, rng)`` gives the data (n_series, n_times) with noise, as the diagnosis takes them.
    noise : float
        Standard deviation of the noise.
    limits : (float, float)
        What the refitted baseline leaves of the noise-free series (rms, `LinearBaseline`) over the noise;
        an effect is drawn again where it leaves less or more, up to `TRIES` times.
    """

    model: ForwardModel
    effects: Sequence[Effect]
    observe: Callable[[Array, np.random.Generator], Any]
    noise: float
    limits: tuple[float, float] = (0.5, 20.0)

    def __call__(self, label: str, rng: np.random.Generator) -> DrawnCase:
        """A case with the effect of this name, or with none for any other label."""
        effect = next((e for e in self.effects if e.name == label), None)
        for _ in range(TRIES):
            theta = draw_prior(self.model.parameters, rng)
            told: dict[str, Any] = {}
            try:
                baseline = LinearBaseline(self.model, theta)
                series, gap = baseline.series, 0.0
                if effect is not None:
                    added, values = draw_effect(effect, self.model, rng)
                    more = with_effects(self.model, [added])
                    series = more.solve(more.configure(np.append(theta, values)))
                    gap = float(np.sqrt(np.mean(baseline.left(series) ** 2)))
                    told = {"components": (effect.family or label,), **told_of(added, values)}
            except (EffectError, SolveError):
                continue
            if effect is None or self.limits[0] * self.noise <= gap <= self.limits[1] * self.noise:
                told |= {"noise": self.noise, "gap": gap, "truth": tuple(map(tuple, series.tolist()))}
                names = (p.name for p in coordinates(self.model.parameters))
                told["drawn"] = {"base_parameters": dict(zip(names, theta.tolist(), strict=True))}
                return DrawnCase(self.observe(series, rng), told)
        raise BlindError(
            f"{label}: no draw of {TRIES} leaves {self.limits[0]:g} to {self.limits[1]:g} times the noise; "
            "give other limits, or a wider prior"
        )


def draw_effect(
    effect: Effect, model: ForwardModel, rng: np.random.Generator
) -> tuple[AddedEffect, tuple[float, ...]]:
    """An effect at a location, uniform over all that it can have, and its parameters from their priors."""
    effect, locations = effect.of(model), effect.locations(model)
    location = locations[int(rng.integers(len(locations)))]
    return effect.at(location), tuple(float(f"{p.prior.draw(rng, 1, {})[0]:.6g}") for p in effect.parameters)


def told_of(added: AddedEffect, values: Sequence[float]) -> dict[str, Any]:
    """Fields of a `CaseKey` about an effect."""
    low, high = (float(x) for x in added.effect.parameters[0].prior.quantile(CENTRAL))
    return {
        "place": added.location.part,
        "subtree": added.location.subtree,
        "parameter": values[0],
        "prior_95": (low, high),
    }
