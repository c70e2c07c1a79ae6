"""Posteriors as files, whole and slim."""

from __future__ import annotations

import random

import arviz as az
import h5py
import numpy as np
import pytest
import xarray as xr

from gaussian import a_record, autoregressive, independent_draws
from zoo.core.arviz_lines import InferenceData, dataset, datasets, made, of_draws
from zoo.core.inference.convergence import diagnostics, verdict
from zoo.core.inference.record import ResultsError, RunRecord
from zoo.core.outputs import OutputFileError
from zoo.core.posterior.storage import NoDigestWarning, digest_of, load, save_posterior, slim_posterior


@pytest.fixture
def record() -> RunRecord:
    return a_record()


@pytest.fixture
def idata() -> InferenceData:
    return independent_draws()


def test_record_survives_the_file(tmp_path, idata, record):
    record.attach(idata)
    path = save_posterior(idata, tmp_path / "B.nc")
    again = load(path)
    assert RunRecord.of(again) == record
    np.testing.assert_array_equal(again.posterior.chi, idata.posterior.chi)
    np.testing.assert_array_equal(again.sample_stats.lp, idata.sample_stats.lp)
    assert list(tmp_path.iterdir()) == [path]  # no temporary file left
    path.unlink()  # and the file is not held open


def test_save_and_load_say_what_is_wrong(tmp_path, idata):
    with pytest.raises(OutputFileError, match=r"folder .*nowhere does not exist; create it"):
        save_posterior(idata, tmp_path / "nowhere" / "A.nc")
    with pytest.raises(ResultsError, match=r"A\.nc: no such file; `zoo sample MODEL STUDY -o A\.nc`"):
        load(tmp_path / "A.nc")
    (tmp_path / "text.nc").write_text("not a posterior")
    with pytest.raises(ResultsError, match=r"text\.nc: not a readable NetCDF file"):
        load(tmp_path / "text.nc")
    of_draws({"prior": {"a": np.zeros((1, 3))}}).to_netcdf(str(tmp_path / "prior.nc"))
    with pytest.raises(ResultsError, match="no group 'posterior'"):
        load(tmp_path / "prior.nc")


def test_slim_keeps_parameters_record_and_the_verdict_on_all_draws(tmp_path, record):
    rng = np.random.default_rng(5)
    draws = {
        "c": autoregressive(rng, 4, 1000, 0.5),
        "chi": 5e4 + rng.normal(size=(4, 1000, 3)),
        "waves": rng.normal(size=(4, 1000, 7)),
    }
    stats = {"accepted": np.linspace(0.1, 0.4, 4)[:, None].repeat(1000, 1)}
    whole = of_draws(
        {"posterior": draws, "sample_stats": stats, "observed_data": {"y": np.arange(7.0)}},
        dims={"waves": ["time"], "y": ["time"]},
        coords={"time": np.arange(7.0)},
    )
    record.attach(whole)
    small = load(save_posterior(slim_posterior(whole, 200), tmp_path / "B.nc"))
    assert list(datasets(small)) == ["posterior"]
    assert set(small.posterior.data_vars) == {"c", "chi"}
    assert "time" not in small.posterior.coords
    assert small.posterior.sizes == {"chain": 4, "draw": 50, "chi_dim_0": 3}
    kept = small.posterior.draw.to_numpy()
    assert (kept[0], kept[-1]) == (0, 999)
    assert set(np.diff(kept)) <= {20, 21}
    np.testing.assert_allclose(small.posterior.c, whole.posterior.c.isel(draw=kept), rtol=1e-6)
    assert RunRecord.of(small) == record
    found = diagnostics(small)
    assert found == diagnostics(whole)
    judged = verdict(whole)
    assert found.verdict == judged
    np.testing.assert_allclose(found.acceptance, np.linspace(0.1, 0.4, 4))
    assert diagnostics(slim_posterior(small, 40)).verdict.draws == 1000  # still of the whole run
    assert verdict(small).draws == 50
    assert whole.posterior.sizes["draw"] == 1000


def test_slim_refuses(idata, record):
    with pytest.raises(ResultsError, match="no run record"):
        slim_posterior(idata)
    record.attach(idata)
    with pytest.raises(ResultsError, match="n_draws = 0: keep at least one"):
        slim_posterior(idata, 0)
    idata.attrs["diagnostics_of_the_whole_run"] = "{}"
    with pytest.raises(ResultsError, match="slim the posterior again"):
        diagnostics(idata)


@pytest.fixture
def stored(tmp_path, idata, record):
    """A small posterior's file, with text, truth values and numbers among its content."""
    few = dataset(idata).isel(draw=slice(30)).assign_coords(chi_dim_0=["one", "two"])
    small = made({"posterior": few, "sample_stats": (few[["c"]] > 0).rename(c="diverging")})
    record.attach(small)
    return save_posterior(small, tmp_path / "B.nc")


def test_no_damage_to_a_posterior_goes_unseen(tmp_path, stored):
    """Flipped bits one at a time, cuts, blocks of zeros: refused in one line, or without any difference."""
    raw, whole, damaged = stored.read_bytes(), load(stored), tmp_path / "damaged.nc"
    rng, refused = random.Random(4), []
    for i in range(300):
        content = bytearray(raw)
        if i < 200:
            content[rng.randrange(len(raw))] ^= 1 << rng.randrange(8)
        elif i < 250:
            content = content[: rng.randrange(len(raw))]
        else:
            first = rng.randrange(len(raw) - 100)
            content[first : first + 100] = bytes(100)
        damaged.write_bytes(content)
        try:
            found = load(damaged)
        except ResultsError as error:
            refused.append(str(error))
        else:
            assert i >= 200
            assert list(datasets(found)) == list(datasets(whole))
            assert all(found[name].identical(whole[name]) for name in datasets(whole))
    assert len(refused) >= 230
    assert all(text.startswith(str(damaged)) and "\n" not in text for text in refused)


def test_a_value_changed_by_another_program_is_refused(stored):
    """By one that knows the format and leaves a whole NetCDF file."""
    with h5py.File(stored, "r+") as opened:
        opened["posterior/c"][1, 7] += 1e-9
    with pytest.raises(
        ResultsError, match=r"B\.nc: damaged, its content does not fit its digest; sample again"
    ):
        load(stored)


@pytest.mark.parametrize("what", ["seed", "units", "group"])
def test_attributes_and_groups_are_in_the_digest(stored, what):
    with h5py.File(stored, "r+") as opened:
        if what == "seed":
            text = opened.attrs["run_record"]
            opened.attrs["run_record"] = text.replace('"seed": 7', '"seed": 8')
        elif what == "units":
            opened["posterior/c"].attrs["units"] = "kg"
        else:
            del opened["sample_stats"]
    with pytest.raises(ResultsError, match="does not fit its digest"):
        load(stored)


def test_a_posterior_of_another_program_is_read_and_said_to_hold_no_digest(tmp_path, idata):
    file = tmp_path / "other.nc"
    idata.to_netcdf(str(file))
    with pytest.warns(NoDigestWarning, match=r"other\.nc: holds no digest of its content"):
        found = load(file)
    assert digest_of(found) == digest_of(load(save_posterior(found, tmp_path / "ours.nc")))


def test_other_programs_read_a_posterior_with_a_digest(stored, idata):
    draws = xr.open_dataset(stored, group="posterior")
    np.testing.assert_array_equal(draws.c, idata.posterior.c[:, :30])
    draws.close()
    assert len(az.from_netcdf(str(stored)).attrs["sha256"]) == 64
