"""Spectral error models, against dense covariance matrices."""

import numpy as np
import pytest
from scipy.linalg import circulant
from scipy.stats import multivariate_normal

from zoo.core.data import Data
from zoo.core.errors.base import ErrorModelError
from zoo.core.errors.spectral import (
    Cosines,
    GroupErrors,
    Harmonics,
    Spectral,
    Uneven,
    log_density,
    spectral_errors,
)
from zoo.core.parameters import variable_name

GROUP, PERIOD = "pressure", 0.11


def bound(values: np.ndarray, kind: type[Spectral] = Harmonics) -> Spectral:
    n = values.shape[1]
    period = PERIOD if kind is Harmonics else None
    data = Data(np.arange(n) * PERIOD / n, values, groups=[GROUP] * len(values), period=period)
    return kind().bind(data)


def dense(H: Spectral, errors: GroupErrors, n_series: int, *, noise: bool = True) -> np.ndarray:
    """Covariance of all series in time, from autocovariances that are summed over harmonics here."""
    n, T = H.n, H.on.duration
    k = np.minimum(np.arange(n), n - np.arange(n))
    omega = 2 * np.pi * k / T
    lags = np.cos(2 * np.pi * np.outer(np.arange(n), np.arange(n)) / n)

    def covariance(f: np.ndarray) -> np.ndarray:
        return np.asarray(circulant(lags @ (f / f.sum())))

    own = np.zeros((n, n))
    if noise:
        own = errors.sigma**2 * (
            np.eye(n) + errors.ratio**2 * covariance(1 / (1 + (omega * errors.tau) ** 2))
        )
    smooth = errors.delta**2 * covariance(np.exp(-0.5 * (omega * errors.length) ** 2))
    between = errors.shared + (1 - errors.shared) * np.eye(n_series)
    return np.asarray(np.kron(np.eye(n_series), own) + np.kron(between, smooth))


@pytest.mark.parametrize("kind", [Harmonics, Cosines])
@pytest.mark.parametrize("n", [16, 17])
def test_transforms_are_orthonormal_and_invertible(n: int, kind: type[Spectral]) -> None:
    rng = np.random.default_rng(1)
    y = rng.standard_normal((3, n))
    H = bound(y, kind)
    z = H.flat(y)
    assert z.shape == (3 * n,)
    assert np.sum(z**2) == pytest.approx(np.sum(y**2))
    np.testing.assert_allclose(H.unflat(z), y, atol=1e-12)
    np.testing.assert_allclose(H.flat(np.stack([y, 2 * y])), np.stack([z, 2 * z]), atol=1e-12)


@pytest.mark.parametrize("kind", [Harmonics, Cosines])
def test_each_coefficient_is_a_wave_of_its_frequency(kind: type[Spectral]) -> None:
    """y(t - dt) - 2 y(t) + y(t + dt) = -4 sin^2(omega dt/2) y(t), of any sine or cosine."""
    H = bound(np.zeros((1, 24)), kind)
    dt = PERIOD / 24
    waves = H.inverse(np.eye(24)[:, None])[:, 0]
    bent = waves[:, :-2] - 2 * waves[:, 1:-1] + waves[:, 2:]
    np.testing.assert_allclose(bent, -4 * np.sin(H.omega * dt / 2)[:, None] ** 2 * waves[:, 1:-1], atol=1e-12)


@pytest.mark.parametrize("n", [16, 17])
def test_density_is_that_of_the_dense_covariance(n: int) -> None:
    rng = np.random.default_rng(2)
    y = rng.standard_normal((3, n))
    H = bound(y)
    errors = GroupErrors(0.5, 0.8, 0.004, 0.7, 0.01, 0.6)
    wanted = multivariate_normal(np.zeros(3 * n), dense(H, errors, 3)).logpdf(y.ravel())
    assert log_density(H.flat(y), H.variances({GROUP: errors})) == pytest.approx(wanted, rel=1e-10)


def test_cosines_hold_a_line_that_harmonics_take_for_a_jump() -> None:
    """A record that drifts: its highest coefficients are far smaller in cosines than in harmonics."""
    t = np.arange(256) * PERIOD / 256
    drift = (t / PERIOD)[None]
    tails = []
    for kind in (Harmonics, Cosines):
        H = bound(drift, kind)
        high = H.k > 0.5 * H.k.max()
        tails.append(float(np.sum(H.flat(drift)[high] ** 2)))
    assert tails[1] < 1e-3 * tails[0]


def test_the_transform_is_chosen_by_the_data() -> None:
    t = np.arange(16) * PERIOD / 16
    assert isinstance(spectral_errors(Data(t, np.sin(t)[None], period=PERIOD)), Harmonics)
    assert isinstance(spectral_errors(Data(t, np.sin(t)[None])), Cosines)
    with pytest.raises(ErrorModelError, match="not periodic"):
        Harmonics().bind(Data(t, np.sin(t)[None]))


def test_too_short_a_record_is_refused() -> None:
    t = np.arange(5) * PERIOD / 5
    with pytest.raises(ErrorModelError, match="1 series of 5 samples: give at least one series of 8"):
        Harmonics().bind(Data(t, np.sin(t)[None], period=PERIOD))


def test_noise_that_is_known_is_not_fitted():
    time = np.arange(256) / 256
    data = Data(time, np.random.default_rng(3).normal(0.0, 0.5, (2, 256)), groups=["p", "q"], period=1.0)
    errors = Harmonics(known={"p": 0.8}).bind(data)
    names = [p.name for p in errors.parameters]
    assert "sigma_p" not in names
    assert "sigma_q" in names
    values = {p.name: np.asarray(0.0 if "ratio" in p.name else 0.5) for p in errors.parameters}
    np.testing.assert_allclose(errors.variance(values), [[0.64] * 256, [0.25] * 256])
    wanted = set(map(variable_name, names))
    assert set(errors.suggested({"p": GroupErrors(0.8), "q": GroupErrors(1.0)})) == wanted


@pytest.mark.parametrize("duration", [0.1, 1800.0])
def test_suggested_values_are_inside_their_priors_in_any_unit_of_time(duration: float) -> None:
    """A start on a bound has no finite density."""
    times = np.linspace(0.0, duration, 90, endpoint=False)
    errors = Cosines().bind(Data(times, np.sin(times / duration), labels=["y"]))
    start = errors.suggested({"y": GroupErrors(0.1, delta=0.0, length=errors.typical_length)})
    for p in errors.parameters:
        low, high = p.prior.support
        assert low < start[p.name] < high, p.name


@pytest.mark.parametrize("kind", [Harmonics, Cosines])
@pytest.mark.parametrize("n", [16, 17])
def test_times_in_equal_steps_have_the_same_coefficients_and_spectra_by_either(
    n: int, kind: type[Spectral]
) -> None:
    y = np.random.default_rng(1).standard_normal((2, n))
    even, uneven = bound(y, kind), Uneven().bind(bound(y, kind).on)
    order, other = (np.argsort(np.abs(H.transform(y)[1])) for H in (even, uneven))
    np.testing.assert_allclose(
        np.abs(even.transform(y)[1])[order], np.abs(uneven.transform(y)[1])[other], atol=1e-12
    )
    np.testing.assert_allclose(even.rough(0.01)[order], uneven.rough(0.01)[other], rtol=1e-9)
    np.testing.assert_allclose(even.smooth(0.01)[order], uneven.smooth(0.01)[other], atol=1e-12)


@pytest.mark.parametrize("period", [None, PERIOD])
def test_the_density_where_samples_are_missing_is_nearly_that_of_their_covariance(
    period: float | None,
) -> None:
    """White noise beside a smooth process of ten times its size; five of 64 samples are missing."""
    rng, n = np.random.default_rng(3), 64
    kept = np.sort(rng.choice(n, n - 5, replace=False))
    whole = (Cosines() if period is None else Harmonics()).bind(
        Data(np.arange(n) * PERIOD / n, np.zeros((1, n)), period=period)
    )
    errors = {"y0": GroupErrors(0.1, delta=1.0, length=0.05 * PERIOD)}
    K = whole._basis.T @ (whole.variances(errors)[:, None] * whole._basis)
    K = K[np.ix_(kept, kept)]
    H = spectral_errors(data := Data(np.arange(n)[kept] * PERIOD / n, np.zeros((1, n - 5)), period=period))
    assert isinstance(H, Uneven)
    H = H.bind(data)
    y = rng.multivariate_normal(np.zeros(n - 5), K, 200)
    exact = multivariate_normal(np.zeros(n - 5), K).logpdf(y)
    found = log_density(H.flat(y[:, None]), H.variances(errors))
    assert np.mean(np.abs(found - exact)) < 1.0
    none = log_density(H.flat(y[:, None]), H.variances({"y0": GroupErrors(0.1)}))
    assert np.mean(exact - none) > 100.0


def test_harmonics_of_uneven_times_are_refused() -> None:
    data = Data(np.array([0.0, 1, 2, 3, 4, 5, 6, 8]), np.zeros((1, 8)))
    with pytest.raises(
        ErrorModelError, match=r"cosines are of times in equal steps, these are not; use Uneven"
    ):
        Cosines().bind(data)
