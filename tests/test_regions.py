"""Posteriors in several parts: how these are told apart, and chains that jump between them."""

from __future__ import annotations

from pathlib import Path

import arviz as az
import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest

from zoo.regions import Gaussian, labels, region_of, split
from zoo.results import RunRecord
from zoo.sampling import DEMetropolisZ, sample

pytestmark = pytest.mark.filterwarnings("ignore:PyTensor could not link to a BLAS:UserWarning")
SHARE = 0.3
CENTRES = np.array([[0.0, 0.0, 0.0], [7.0, -4.0, 5.0]])
SCALES = np.array([[1.0, 2.0, 0.5], [0.3, 1.0, 2.0]])


def two_parts(centre: float = 1.0) -> pm.Model:
    """Two normals in three dimensions, far apart; the second has 0.3 of the mass."""
    with pm.Model() as model:
        x = pm.Flat("x", shape=3)
        each = [
            pt.sum(pm.logp(pm.Normal.dist(centre * m, s), x)) + np.log(w)
            for m, s, w in zip(CENTRES, SCALES, (1 - SHARE, SHARE), strict=True)
        ]
        pm.Potential("density", pt.logaddexp(*each))
    return model


def chains(rng, n, passing, apart=8.0, d=4):  # type: ignore[no-untyped-def]
    """Four chains of autocorrelated draws, which change between two places `apart` with a probability."""
    x = np.zeros((4, n, d))
    place = np.zeros((4, n))
    for i in range(1, n):
        x[:, i] = 0.8 * x[:, i - 1] + 0.6 * rng.standard_normal((4, d))
        place[:, i] = np.where(rng.uniform(size=4) < passing, 1 - place[:, i - 1], place[:, i - 1])
    x[:, :, 1] += apart * place
    x[:, :, 2] += 0.5 * apart * place
    return x, place


def test_parts_that_chains_pass_between_too_seldom_are_found() -> None:
    x, place = chains(np.random.default_rng(1), 2000, 0.002)
    found = split(x)
    assert found is not None
    assert len(found) == 2
    same = labels(found, x.reshape(-1, 4)) == place.ravel()
    assert max(same.mean(), 1 - same.mean()) > 0.999
    far = found[int(np.argmax([part.mean[1] for part in found]))]
    np.testing.assert_allclose(far.mean, (0.0, 8.0, 4.0, 0.0), atol=0.25)
    np.testing.assert_allclose(np.diag(far.covariance), 1.0, atol=0.3)
    assert [region_of(found, part.mean) for part in found] == [0, 1]


def test_a_third_part_is_told_from_the_largest() -> None:
    """Chains jump between two known parts, one of which is two, late and seldom seen."""
    x, place = chains(np.random.default_rng(2), 2000, 0.3)
    known = [Gaussian(np.array([0.0, 8.0 * i, 4.0 * i, 0.0]), np.eye(4)) for i in (0, 1)]
    x[:, :, 3] += 9.0 * (place == 0) * (np.arange(2000) > 1500) * (np.arange(4) == 2)[:, None]
    found = split(x, known)
    assert found is not None
    assert sorted(round(part.mean[3]) for part in found) == [0, 0, 9]


@pytest.mark.parametrize(("passing", "apart"), [(0.3, 8.0), (0.002, 0.0), (0.002, 1.0)])
def test_what_chains_pass_between_easily_or_without_a_gap_is_one(passing: float, apart: float) -> None:
    x, _ = chains(np.random.default_rng(3), 2000, passing, apart)
    assert split(x) is None


def test_jumps_between_regions_leave_the_posterior_as_it_is() -> None:
    """With Gaussians that fit badly: share, means and scatter of the parts come out right."""
    model = two_parts()
    regions = [
        Gaussian(CENTRES[0] + 0.3, np.diag((1.5, 2.0, 1.0))),
        Gaussian(CENTRES[1], np.diag((0.2, 2.0, 4.0))),
    ]
    step = DEMetropolisZ(
        model=model, crank_nicolson=0.5, regions=regions, reference=regions[0],
        archive=regions[0].colour(np.random.default_rng(0).standard_normal((60, 3))),
    )  # fmt: skip
    step.set_rng(np.random.default_rng(4))
    point = model.initial_point()
    rows = []
    for i in range(24_000):
        if i == 2000:
            step.stop_tuning()
        point, _ = step.step(point)
        rows.append(point["x"])
    x = np.array(rows[2000:])
    there = x[:, 0] > 4.0
    error = np.sqrt(SHARE * (1 - SHARE) / float(az.ess(there[None].astype(float))))
    assert abs(there.mean() - SHARE) < 4 * error
    assert error < 0.03
    for part, which in enumerate((~there, there)):
        for k in range(3):
            draws = x[which, k]
            n = float(az.ess(draws[None]))
            assert abs(draws.mean() - CENTRES[part, k]) < 4 * SCALES[part, k] / np.sqrt(n)
            assert draws.std() == pytest.approx(SCALES[part, k], rel=4 / np.sqrt(n))


def test_chains_begin_again_with_jumps_where_they_pass_too_seldom(tmp_path: Path) -> None:
    """Share, record and what a resumed run gives; draws of the first round do not count."""
    settings = {"tune": 600, "thin": 2, "until_ess": 200, "seed": 5, "cores": 0, "progress": False}
    whole = sample(two_parts(0.85), draws=1000, **settings)  # type: ignore[arg-type]
    record = RunRecord.of(whole)
    assert record.settings["regions"] == 2
    assert record.settings["draws of earlier rounds"] == [1000]
    kept = whole.posterior.sizes["draw"]
    assert record.steps == 4 * (2 * 600 + 2 * (1000 + kept))
    x = whole.posterior.x.to_numpy()
    there = (x[..., 0] > 3.5).astype(float)
    assert there.mean() == pytest.approx(SHARE, abs=4 * np.sqrt(0.21 / float(az.ess(there))))

    folder = tmp_path / "run"
    sample(two_parts(0.85), draws=1000, max_draws=kept - 500, checkpoint=folder, **settings)  # type: ignore[arg-type]
    assert sorted(file.name for file in folder.glob("chain*")) == [f"chain-{k}-1.pkl" for k in range(4)]
    resumed = sample(two_parts(0.85), draws=1000, checkpoint=folder, **settings)  # type: ignore[arg-type]
    np.testing.assert_array_equal(resumed.posterior.x.to_numpy(), x)
    again = RunRecord.of(resumed)
    assert (again.steps, again.solves, again.sittings) == (record.steps, record.solves, 2)
