"""Linear problems with free functions drawn from their own prior, for tests of what is said of components."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from zoo.core.components import FreeFunction
from zoo.core.data import Data
from zoo.core.diagnosis.components.response import Block, Linearised
from zoo.core.diagnosis.discrepancy import SIZE_PART
from zoo.core.errors.spectral import GroupErrors, Harmonics

NOISE = 0.02


def a_function(name: str, component: str, n: int = 6, size: float = 1.0, lengths=(1.5,)) -> FreeFunction:
    return FreeFunction(name, component, np.arange(float(n)), size, lambda c, v: c, lengths=tuple(lengths))


@dataclass(eq=False)
class Toy:
    """Series of one group whose range is 10, responses of a few harmonics to each function, and a truth."""

    functions: Sequence[FreeFunction]
    n_series: int = 2
    n_times: int = 32
    harmonics: int = 5
    noise: GroupErrors = field(default_factory=lambda: GroupErrors(NOISE))
    seed: int = 0

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.times = np.arange(self.n_times) / self.n_times
        wave = 5.0 * np.sin(2 * np.pi * self.times)
        self.base = np.tile(wave, (self.n_series, 1))
        self.errors = Harmonics().bind(self.data_of(self.base))
        self.jacobian = self.smooth(2)
        self.columns = [self.smooth(len(f.at)) for f in self.functions]

    def data_of(self, values: np.ndarray) -> Data:
        labels = [f"y{i}" for i in range(self.n_series)]
        return Data(self.times, values, labels, ["K"] * self.n_series, ["y"] * self.n_series, 1.0)

    def smooth(self, n: int) -> np.ndarray:
        """Random responses (n_series n_times, n) in the first harmonics, as flat coefficients."""
        k = np.arange(1, self.harmonics + 1)[:, None]
        waves = np.concatenate([np.cos(2 * np.pi * k * self.times), np.sin(2 * np.pi * k * self.times)])
        weights = self.rng.standard_normal((n, self.n_series, 2 * self.harmonics)) / self.harmonics
        return self.errors.flat(weights @ waves).T

    @property
    def delta_scale(self) -> float:
        return SIZE_PART * 10.0

    def drawn(self, scales: Sequence[float], delta: float, length: float = 0.05, shared: float = 0.0):
        """Residual coefficients of functions of those sds, and the signal of each and of the discrepancy."""
        parts = []
        for f, X, s in zip(self.functions, self.columns, scales, strict=True):
            root = f.root(f.lengths[0] if f.lengths else None)
            parts.append(X @ (s * root @ self.rng.standard_normal(root.shape[1])))
        own = GroupErrors(0.0, delta=max(delta, 1e-300), length=length, shared=shared)
        S = self.errors.variances({"y": own}, noise=False)
        parts.append(np.sqrt(S) * self.rng.standard_normal(len(S)))
        S = self.errors.variances({"y": self.noise})
        moved = self.jacobian @ self.rng.standard_normal(2)
        return sum(parts) + moved + np.sqrt(S) * self.rng.standard_normal(len(S)), parts

    def problem(self, residual: np.ndarray) -> Linearised:
        return Linearised(
            residual,
            self.jacobian,
            np.ones(2),
            np.zeros(2),
            self.errors,
            {"y": self.noise},
            tuple(Block(f, X) for f, X in zip(self.functions, self.columns, strict=True)),
        )

    def without_parameters(self, signal: np.ndarray) -> np.ndarray:
        """What a fit of the parameters to a signal without noise leaves of it."""
        S = self.errors.variances({"y": self.noise})
        H = (self.jacobian / S[:, None]).T @ self.jacobian + np.eye(2)
        return signal - self.jacobian @ np.linalg.solve(H, self.jacobian.T @ (signal / S))
