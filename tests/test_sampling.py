"""Whole runs: against an analytic posterior, resumed against uninterrupted, and what they refuse."""

from __future__ import annotations

import multiprocessing as mp
import os
import signal
import subprocess
import sys
import textwrap
import time
from collections import Counter
from pathlib import Path

import arviz as az
import numpy as np
import pymc as pm
import pytest

from dying import wait_for
from gaussian import (
    DATA,
    SETTINGS,
    Doubling,
    failing_model,
    gaussian_model,
    gaussian_posterior,
)
from zoo.core.inference.chain import Report
from zoo.core.inference.checkpoint import CheckpointError, Folder
from zoo.core.inference.progress import ChainState, of_chains
from zoo.core.inference.record import RunRecord
from zoo.core.inference.sampling import SamplingError, sample


@pytest.fixture(scope="module")
def uninterrupted():
    return sample(gaussian_model(), cores=2, **SETTINGS)


def test_posterior_is_the_analytic_one():
    idata = sample(gaussian_model(), cores=0, draws=700, tune=600, chains=2, seed=4, progress=False)
    mean, covariance = gaussian_posterior()
    p = idata.posterior
    columns = [p.a.to_numpy(), p.bc.to_numpy()[..., 0], p.bc.to_numpy()[..., 1]]
    for i, draws in enumerate(columns):
        ess = float(az.ess(draws))
        assert ess > 150
        assert abs(draws.mean() - mean[i]) < 4.5 * np.sqrt(covariance[i, i] / ess)
        assert draws.std() == pytest.approx(np.sqrt(covariance[i, i]), rel=0.2)


def test_statistics_and_record(uninterrupted):
    s = uninterrupted.sample_stats
    assert dict(s.sizes) == {"chain": 2, "draw": 150}
    assert {"lp", "accept", "accepted", "solves", "solver_failures"} <= set(s.data_vars)
    assert set(np.unique(s.solves)) == {2}  # thin = 2 steps for each stored draw, one solve each
    assert 0 < float(s.accept.mean()) < 1
    logp = gaussian_model().compile_logp()
    p = uninterrupted.posterior.isel(chain=1, draw=7)
    expected = logp({"a": p.a.to_numpy(), "bc": p.bc.to_numpy()})
    assert float(s.lp[1, 7]) == pytest.approx(float(expected), rel=1e-12)
    record = RunRecord.of(uninterrupted)
    assert (record.model, record.seed, record.sittings, record.failures) == ("gaussian", 11, 1, {})
    assert record.steps == 2 * (200 + 2 * 150)
    assert record.solves_per_step == pytest.approx(1.0, abs=0.01)
    assert record.settings["tune"] == 200
    assert uninterrupted.observed_data.y.to_numpy() == pytest.approx(DATA)


def group_is_gone(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return True
    return False


@pytest.fixture(scope="module")
def short_checkpoint(tmp_path_factory):
    folder = tmp_path_factory.mktemp("short") / "checkpoint"
    sample(gaussian_model(), cores=0, checkpoint=folder, **{**SETTINGS, "draws": 40})
    return folder


def test_finished_run_goes_on_to_more_draws(short_checkpoint, uninterrupted):
    idata = sample(gaussian_model(), cores=0, checkpoint=short_checkpoint, **{**SETTINGS, "seed": None})
    np.testing.assert_array_equal(idata.posterior.bc, uninterrupted.posterior.bc)
    assert RunRecord.of(idata).seed == 11


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"tune": 300}, "tune is 200 there and 300 here"),
        ({"seed": 12}, "seed is 11 there and 12 here"),
        ({"step_options": {"crank_nicolson": 0.1}}, "crank_nicolson of the step options is .* there and 0.1"),
    ],
)
def test_checkpoint_of_other_settings_is_refused(short_checkpoint, change, message):
    with pytest.raises(CheckpointError, match=f"checkpoint of another run: {message}"):
        sample(gaussian_model(), checkpoint=short_checkpoint, **{**SETTINGS, **change})


def test_checkpoint_of_another_model_or_data_is_refused(short_checkpoint):
    with pytest.raises(CheckpointError, match="model is gaussian there and other here"):
        sample(gaussian_model(name="other"), checkpoint=short_checkpoint, **SETTINGS)
    with pytest.raises(CheckpointError, match="log-posterior at three points"):
        sample(gaussian_model(data=DATA + 1e-3), checkpoint=short_checkpoint, **SETTINGS)


def test_checkpoint_in_use_or_no_folder_is_refused(short_checkpoint, tmp_path):
    holder = Folder(short_checkpoint)
    try:
        with pytest.raises(CheckpointError, match="another run is using this checkpoint folder"):
            sample(gaussian_model(), checkpoint=short_checkpoint, **SETTINGS)
    finally:
        holder.close()
    (tmp_path / "file").write_text("")
    with pytest.raises(CheckpointError, match="cannot be used as checkpoint folder"):
        sample(gaussian_model(), checkpoint=tmp_path / "file", **SETTINGS)


def test_failed_solves_are_counted_and_never_accepted():
    idata = sample(failing_model(), draws=200, tune=300, chains=1, thin=1, cores=0, seed=3, progress=False)
    s = idata.sample_stats
    failed = s.solver_failures.to_numpy()
    assert failed.sum() > 10
    assert float(idata.posterior.a.min()) >= 0.0
    np.testing.assert_array_equal(idata.posterior.twice, 2 * idata.posterior.a)
    np.testing.assert_array_equal(failed[failed > 0], 1)
    assert not s.accepted.to_numpy()[failed > 0].any()
    assert RunRecord.of(idata).failures["collapse"] >= failed.sum()


def test_chain_error_reaches_the_caller():
    def explode(value):
        raise FloatingPointError("the bath ran over")

    class Exploding(Doubling):
        def perform(self, node, inputs, output_storage):
            super().perform(node, inputs, output_storage)
            if self.n["solves"] > 400:
                explode(inputs)

    with pm.Model() as model:
        a = pm.Normal("a")
        x, _ = Exploding()(a[None])
        pm.Normal("y", x[0], 1.0, observed=0.0)
    with pytest.raises(SamplingError, match="chain 0: FloatingPointError: the bath ran over") as caught:
        sample(model, draws=2000, tune=0, chains=1, thin=1, cores=1, seed=1, progress=False)
    assert any("Traceback" in note for note in caught.value.__notes__)


def test_chains_in_turns_draw_what_processes_draw(tmp_path, uninterrupted):
    """In this process, interrupted by a checkpoint halfway: the draws of the run in processes."""
    settings = {**SETTINGS, "cores": 0}
    first = sample(
        gaussian_model(), checkpoint=tmp_path / "c", **{**settings, "draws": SETTINGS["draws"] // 2}
    )
    again = sample(gaussian_model(), checkpoint=tmp_path / "c", **settings)
    for name in ("a", "bc"):
        whole = uninterrupted.posterior[name].to_numpy()
        np.testing.assert_array_equal(again.posterior[name].to_numpy(), whole)
        half = first.posterior[name].to_numpy()
        np.testing.assert_array_equal(half, whole[:, : half.shape[1]])


def test_until_ess_goes_on_and_stops_at_the_limit(capsys):
    few = {"tune": 200, "chains": 2, "thin": 1, "cores": 0, "seed": 2}
    idata = sample(gaussian_model(), draws=100, until_ess=150, progress=True, **few)
    n = idata.posterior.sizes["draw"]
    assert n > 100
    for method in ("bulk", "tail"):
        assert min(float(v.min()) for v in az.ess(idata.posterior, method=method).values()) >= 150
    assert RunRecord.of(idata).settings["first check"] == 100
    err = capsys.readouterr().err
    assert "3 dimensions, 2 chains of demetropolisz, tune 200" in err
    assert " of 150: " in err
    assert "converged" in err
    short = sample(gaussian_model(), draws=50, until_ess=4000, max_draws=70, progress=False, **few)
    assert short.posterior.sizes["draw"] == 70


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"draws": 0}, "draws = 0: must be a whole number of at least 1"),
        ({"tune": -1}, "tune = -1: must be a whole number of at least 0"),
        ({"chains": 0}, "chains = 0"),
        ({"cores": -1}, "cores = -1"),
        ({"thin": 0}, "thin = 0"),
        ({"max_draws": 10}, "max_draws = 10: must be a whole number of at least 1000"),
        ({"until_ess": float("nan")}, "until_ess = nan"),
        ({"until_ess": 400, "chains": 1}, "chains = 1: until_ess needs R-hat"),
        ({"seed": -1}, "seed = -1"),
    ],
)
def test_settings_are_checked(settings, message):
    with pytest.raises(SamplingError, match=message):
        sample(gaussian_model(), progress=False, **settings)


def test_one_line_on_chains():
    states = [ChainState(chain) for chain in range(2)]
    for state in states:
        state.update(Report(500, 200, 5.0, 500, 150.0, Counter(cfl=3), {"a": np.zeros(200)}, {}, b""))
    line = of_chains(states, 400)
    assert line == "draws 200 200 of 400, accepted 30%, 1000 solves (100/s a core), 6 failed"


class Dying(Doubling):
    """Kills its process after some solves, once."""

    def __init__(self, marker: str) -> None:
        super().__init__()
        self.marker = marker

    def perform(self, node, inputs, output_storage):
        super().perform(node, inputs, output_storage)
        if mp.parent_process() is not None and self.n["solves"] == 150 and not Path(self.marker).exists():
            Path(self.marker).touch()
            os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_a_chain_whose_process_dies_goes_on_in_another(tmp_path):
    def model():
        with pm.Model() as made:
            a = pm.Normal("a", shape=2)
            x, _ = Dying(str(tmp_path / "died"))(a)
            pm.Normal("y", x, 1.0, observed=[0.3, -1.0])
        return made

    found = sample(model(), cores=2, **SETTINGS)
    assert (tmp_path / "died").exists()
    whole = sample(model(), cores=0, **SETTINGS)
    np.testing.assert_array_equal(found.posterior.a, whole.posterior.a)
    assert RunRecord.of(found).solves == RunRecord.of(whole).solves


STUCK = """
    import ctypes, multiprocessing, pathlib, sys
    sys.path.insert(0, {tests!r})
    from gaussian import SETTINGS, Doubling
    import pymc as pm
    from zoo.core.inference.sampling import sample

    class Stuck(Doubling):
        def perform(self, node, inputs, output_storage):
            super().perform(node, inputs, output_storage)
            if multiprocessing.parent_process() is not None:
                pathlib.Path({marker!r}).touch()
                ctypes.CDLL(None).sleep(600)  # in C

    with pm.Model() as model:
        a = pm.Normal("a", shape=2)
        x, _ = Stuck()(a)
        pm.Normal("y", x, 1.0, observed=[0.3, -1.0])
    sample(model, cores=2, checkpoint={folder!r}, **SETTINGS)
"""


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="signals of POSIX")
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_a_run_ends_at_once_inside_a_solve_too(tmp_path, how):
    """A script without a guard for `__main__`, interrupted or killed; its processes end with it."""
    script, marker, folder = tmp_path / "run.py", tmp_path / "stuck", tmp_path / "c"
    code = STUCK.format(tests=str(Path(__file__).parent), marker=str(marker), folder=str(folder))
    script.write_text(textwrap.dedent(code))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    run = subprocess.Popen([sys.executable, str(script)], start_new_session=True, env=environment)
    wait_for(marker.exists, 600.0)
    os.kill(run.pid, how)
    began = time.monotonic()
    run.wait()
    wait_for(lambda: group_is_gone(run.pid))
    assert time.monotonic() - began < 30.0  # the solve that it does not wait for takes ten minutes
    Folder(folder).close()  # no longer in use
