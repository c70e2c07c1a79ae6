"""What tests of sampling share: models with analytic posteriors, draws of known laws, a record."""

from __future__ import annotations

import time
from collections import Counter

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from pytensor.graph.basic import Apply
from pytensor.graph.op import Op

from zoo.core.arviz_lines import InferenceData, of_draws
from zoo.core.in_numba import called_as_python
from zoo.core.inference.record import RunRecord


@called_as_python
class Doubling(Op):
    """A gradient-free operation that doubles its input, counts its solves and fails below a limit."""

    __props__ = ("limit",)

    def __init__(self, limit: float = -np.inf, seconds: float = 0.0) -> None:
        self.limit = limit
        self.seconds = seconds
        self.n: Counter[str] = Counter()

    @property
    def counts(self):
        failures = {"collapse": self.n["collapse"]} if self.n["collapse"] else {}
        return {"solves": self.n["solves"], "evaluations": self.n["solves"], "failures": failures}

    def make_node(self, x):
        x = pt.as_tensor_variable(x)
        return Apply(self, [x], [pt.vector(dtype="float64"), pt.scalar(dtype="int8")])

    def perform(self, node, inputs, output_storage):
        self.n["solves"] += 1
        ok = bool(inputs[0].min() >= self.limit)
        self.n["collapse"] += not ok
        if self.seconds:
            time.sleep(self.seconds)
        output_storage[0][0] = inputs[0] * 2.0
        output_storage[1][0] = np.asarray(ok, dtype=np.int8)

    def infer_shape(self, *node_and_shapes):
        return [node_and_shapes[-1][0], ()]


PRIOR_SD = np.array([1.0, 2.0, 0.5])
MIXING = np.array([[1.0, 0.9, 0.0], [0.0, 1.0, 0.5], [0.4, 0.0, 1.0]])
NOISE = np.array([0.5, 0.2, 1.0])
DATA = np.array([1.0, -2.0, 0.5])


def gaussian_model(seconds: float = 0.0, data=DATA, name: str = "gaussian") -> pm.Model:
    """Three correlated Gaussian parameters with an analytic posterior."""
    with pm.Model(name="") as model:
        a = pm.Normal("a", 0.0, PRIOR_SD[0])
        bc = pm.Normal("bc", 0.0, PRIOR_SD[1:], shape=2)
        x, _ = Doubling(seconds=seconds)(pt.concatenate([a[None], bc]))
        pm.Normal("y", pt.dot(MIXING, x / 2.0), NOISE, observed=data)
    model.zoo = type("Record", (), {"name": name, "study": None, "options": None})()
    return model


def gaussian_posterior() -> tuple[np.ndarray, np.ndarray]:
    precision = np.diag(PRIOR_SD**-2) + MIXING.T @ np.diag(NOISE**-2) @ MIXING
    covariance = np.linalg.inv(precision)
    return covariance @ MIXING.T @ (DATA / NOISE**2), covariance


def failing_model() -> pm.Model:
    """The solver fails in half of the prior; the likelihood is zero there."""
    with pm.Model() as model:
        a = pm.Normal("a", 0.3, 1.0)
        x, ok = Doubling(limit=0.0)(a[None])
        pm.Potential("solved", pt.switch(pt.eq(ok, 1), 0.0, -np.inf))
        pm.Deterministic("twice", x[0])
    return model


SETTINGS = {"draws": 150, "tune": 200, "chains": 2, "thin": 2, "seed": 11, "progress": False}


def autoregressive(rng: np.random.Generator, chains: int, draws: int, phi: float) -> np.ndarray:
    """AR(1) draws with unit variance; their effective sample size is n (1 - phi) / (1 + phi)."""
    noise = rng.normal(size=(chains, draws))
    out = np.empty((chains, draws))
    out[:, 0] = noise[:, 0]
    for i in range(1, draws):
        out[:, i] = phi * out[:, i - 1] + np.sqrt(1 - phi**2) * noise[:, i]
    return out


def a_record() -> RunRecord:
    return RunRecord(
        model="B",
        study="demo",
        study_checksum="abc",
        conventions={"name": "printed", "wall_factor": 1.0},
        solver={"dx_cm": 0.025},
        settings={"step": "demetropolisz", "tune": 1000},
        seed=7,
        solves=4000,
        steps=4000,
        mode_evaluations=120,
        failures={"cfl": 2},
        solves_per_draw=6.0,
        solves_per_step=1.0,
        wall_seconds=12.5,
        sittings=1,
        started="2026-01-01T00:00:00+00:00",
    )


def independent_draws() -> InferenceData:
    rng = np.random.default_rng(0)
    draws = {"c": rng.normal(size=(4, 1000)), "chi": rng.normal(size=(4, 1000, 2))}
    return of_draws({"posterior": draws, "sample_stats": {"lp": rng.normal(size=(4, 1000))}})
