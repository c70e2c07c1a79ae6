"""Surrogate runs that are killed: no solve is made twice, and the draws are those of an uninterrupted run."""

from __future__ import annotations

import json
import shutil
import time
from dataclasses import replace

import numpy as np
import pytest

from test_surrogate import DATA, FORWARD, KNOWN, decay
from zoo.core.forward import FunctionModel, SolveError
from zoo.core.inference import methods
from zoo.core.inference import surrogate_sampling as correcting
from zoo.core.inference.checkpoint import CheckpointError, CheckpointInUseError, Folder
from zoo.core.inference.logposterior import SamplingError
from zoo.core.inference.methods import choose, sample
from zoo.core.inference.record import RunRecord
from zoo.core.inference.surrogate_sampling import sample_surrogate
from zoo.core.inference.workers import Inline
from zoo.core.model import bayesian_model
from zoo.core.posterior.arviz_groups import N_PRIOR, add_groups
from zoo.core.posterior.arviz_groups import sample as sample_with_groups
from zoo.core.surrogate.library import Library

SETTINGS = {"draws": 100, "tune": 100, "seed": 3, "cores": 1, "progress": False}


class Killed(BaseException):
    """What a run does not catch."""


class Counting(FunctionModel):
    """A simulator that fails in places, counts, and at one of its solves dies."""

    def __init__(self, last: int | None = None) -> None:
        super().__init__(decay, FORWARD.parameters, FORWARD.outputs, name="decay")
        for name, value in {"n": 0, "last": last, "seen": set()}.items():
            object.__setattr__(self, name, value)

    def solve(self, configuration, outputs=None):
        object.__setattr__(self, "n", self.n + 1)
        self.seen.add((float(configuration["rate"]), float(configuration["level"])))
        if self.n == self.last:
            raise Killed
        if configuration["level"] > 0.63:
            raise SolveError("too high", "collapse")
        return super().solve(configuration, outputs)


class Slow(FunctionModel):
    """One that takes its time, and may fail after that."""

    def __init__(self, seconds: float, fails: bool = False) -> None:
        super().__init__(decay, FORWARD.parameters, FORWARD.outputs, name="decay")
        for name, value in {"seconds": seconds, "fails": fails}.items():
            object.__setattr__(self, name, value)

    def solve(self, configuration, outputs=None):
        time.sleep(self.seconds)
        if self.fails:
            raise SolveError("never", "collapse")
        return super().solve(configuration, outputs)


def model_of(forward):
    return bayesian_model("toy", forward, DATA, KNOWN)


@pytest.fixture(autouse=True)
def few(monkeypatch):
    monkeypatch.setattr(correcting, "THIN", 2)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run, its simulator, and its checkpoint."""
    folder = tmp_path_factory.mktemp("whole") / "c"
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(correcting, "THIN", 2)
        simulator = Counting()
        return sample_surrogate(model_of(simulator), checkpoint=folder, **SETTINGS), simulator, folder


def test_a_killed_run_draws_what_an_uninterrupted_one_does(whole, tmp_path):
    uninterrupted, all_of_them, _ = whole
    checkpoint = {"checkpoint": tmp_path / "c"}
    dies = Counting(last=all_of_them.n // 2)
    with pytest.raises(Killed):
        sample_surrogate(model_of(dies), **checkpoint, **SETTINGS)
    goes_on = Counting()
    again = sample_surrogate(model_of(goes_on), **checkpoint, **{**SETTINGS, "seed": None})
    for name in ("rate", "level"):
        np.testing.assert_array_equal(again.posterior[name], uninterrupted.posterior[name])
    one, two = (RunRecord.of(idata) for idata in (uninterrupted, again))
    assert (two.seed, two.sittings, two.solves, two.failures) == (3, 2, one.solves, one.failures)
    assert one.failures["collapse"] > 0  # they are kept, too
    begins = dies.n + goes_on.n - all_of_them.n  # the search for the posterior is made again
    assert goes_on.n < all_of_them.n
    assert 0 < begins < 120
    assert len(dies.seen & goes_on.seen) <= begins


def test_other_runs_and_damaged_files_are_refused_and_nothing_is_lost(whole, tmp_path):
    shutil.copytree(whole[2], tmp_path, dirs_exist_ok=True)
    refused = [({"seed": 4}, "seed is 3 there and 4 here"), ({"tune": 90}, "tune is 100 there and 90 here")]
    for change, message in refused:
        with pytest.raises(CheckpointError, match=message):
            sample_surrogate(model_of(Counting()), checkpoint=tmp_path, **{**SETTINGS, **change})
    other = bayesian_model("toy", FORWARD, replace(DATA, values=DATA.values + 1e-3), KNOWN)
    with pytest.raises(CheckpointError, match="another run: study checksum"):
        sample_surrogate(other, checkpoint=tmp_path, **SETTINGS)
    holder = Folder(tmp_path)
    try:
        with pytest.raises(CheckpointInUseError, match="another run is using"):
            sample_surrogate(model_of(Counting()), checkpoint=tmp_path, **SETTINGS)
    finally:
        holder.close()
    file = tmp_path / "solves.memo"
    raw = file.read_bytes()
    file.write_bytes(raw[:-9] + b"12345678\n")
    with pytest.raises(CheckpointError, match="is damaged, or of another run"):
        sample_surrogate(model_of(Counting()), checkpoint=tmp_path, **SETTINGS)
    file.write_bytes(raw)
    simulator = Counting()
    again = sample_surrogate(model_of(simulator), checkpoint=tmp_path, **SETTINGS)
    np.testing.assert_array_equal(again.posterior["rate"], whole[0].posterior["rate"])
    assert simulator.n < 120 < RunRecord.of(again).settings["surrogate"]["building solves"]


def test_a_run_goes_on_by_the_method_it_began_with(whole, tmp_path):
    model = model_of(Counting())
    assert choose(model)[0] == "exact"
    assert choose(model, checkpoint=whole[2]) == ("surrogate", "a checkpoint of such a run is there")
    for step, method in (("nuts", "nuts"), ("demetropolisz", "exact"), (None, "exact")):
        (tmp_path / "run.json").write_text(json.dumps({"identity": {"step": step}}))
        assert choose(model, checkpoint=tmp_path)[0] == method
    for broken in ("[]", "{", '{"identity": 3}'):
        (tmp_path / "run.json").write_text(broken)
        assert choose(model, checkpoint=tmp_path)[0] == "exact"  # which says what is wrong with it
    with pytest.raises(CheckpointError, match="cannot be read"):
        sample(model, method="auto", checkpoint=tmp_path, **SETTINGS)


def test_a_setting_of_another_method_does_not_change_that_of_a_run(whole, tmp_path):
    shutil.copytree(whole[2], tmp_path / "c")
    for setting in ({"thin": 2}, {"executor": Inline()}):
        with pytest.raises(SamplingError, match=f"{next(iter(setting))} = .*: method surrogate has no use"):
            sample(model_of(Counting()), method="auto", checkpoint=tmp_path / "c", **setting, **SETTINGS)


def test_slow_solves_ask_for_a_surrogate(monkeypatch):
    assert choose(model_of(Slow(0.03)))[0] == "exact"
    monkeypatch.setattr(methods, "SLOW", 0.02)
    method, reason = choose(model_of(Slow(0.03)))
    assert method == "surrogate"
    assert reason.startswith("a solve takes 0.03")
    assert choose(model_of(Slow(0.0)))[0] == "exact"
    assert choose(model_of(Slow(0.03, fails=True)))[0] == "surrogate"  # which says that nothing can be solved


def test_draws_that_were_solved_are_not_solved_for_their_predictions(whole):
    simulator = Counting()
    library = Library(simulator)  # empty, and taken all the same
    idata = sample_with_groups(model_of(simulator), method="surrogate", library=library, **SETTINGS)
    assert simulator.n <= whole[1].n + N_PRIOR  # 400 more without them
    np.testing.assert_array_equal(idata.posterior["rate"], whole[0].posterior["rate"])  # no checkpoint here
    assert len(library) > 400
    again = add_groups(idata, model_of(Counting()))
    for group in ("log_likelihood", "posterior_predictive"):
        np.testing.assert_array_equal(idata[group].y, again[group].y)
