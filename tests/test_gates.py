"""Gates on a comparison of models: what CI asks of it."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.stats import norm

from zoo.report.gates import (
    ComparisonFile,
    Gate,
    GateError,
    ModelScore,
    StudyScores,
    change,
    judge,
    junit,
    markdown,
    read_comparison,
)


def one_model(shift: float = 0.0, *, converged: bool = True, n: int = 400, seed: int = 1) -> ModelScore:
    """A normal model of standard normal data, its mean off by `shift`."""
    y = np.random.default_rng(seed).standard_normal(n)
    terms = norm.logpdf(y, shift)
    row = {"rank": 0, "difference": 0.0, "difference_se": 0.0, "waic": -2.0 * float(terms.sum()),
           "waic_se": 2.0 * float(np.sqrt(n * terms.var())), "converged": converged, "rhat_max": 1.0,
           "ess_min": 900.0, "pareto_k_bad": 0, "convergence": ""}  # fmt: skip
    return ModelScore(row=row, terms=terms.tolist())


def a_file(model: ModelScore, checksum: str = "a") -> ComparisonFile:
    return ComparisonFile(
        criterion="waic", studies={"s": StudyScores(checksum=checksum, models={"A": model})}, versions={}
    )


@pytest.mark.parametrize(
    ("text", "failed"),
    [
        ("converged=no", False),
        ("converged != yes", False),
        ("ess_min < 1000", True),
        ("ess_min<800", False),
        ("rhat_max >= 1", True),
        ("waic > baseline", True),
        ("waic > baseline + 100", False),
        ("waic < baseline - 1e3", False),
    ],
)
def test_a_gate_fails_where_what_it_says_is_so(text: str, failed: bool) -> None:
    now, then = a_file(one_model(0.1)), a_file(one_model())
    [one] = judge(now, [Gate.read(text)], then)
    assert one.failed is failed


def test_a_difference_to_the_baseline_has_the_error_of_paired_terms() -> None:
    """Of log p(y; 0) - log p(y; m) = m^2/2 - m y the sd is m, so that of twice the sum is 2 m sqrt(n)."""
    shift, n = 0.1, 100_000
    difference, se = change(one_model(shift, n=n), one_model(n=n), "waic")
    assert se == pytest.approx(2.0 * shift * np.sqrt(n), rel=0.02)
    assert difference == pytest.approx(n * shift**2, abs=4.0 * se)


def test_the_error_of_a_difference_has_that_of_both_runs_of_the_sampler() -> None:
    """All terms share it, so that the terms' scatter does not show it."""
    one = one_model()
    drawn = one.model_copy(update={"row": one.row | {"waic_mcse": 3.0}})
    again = one.model_copy(update={"row": one.row | {"waic_mcse": 4.0, "waic": one.row["waic"] + 6.0}})
    assert change(again, drawn, "waic") == (pytest.approx(6.0), pytest.approx(5.0))
    assert not judge(a_file(again), [Gate.read("waic > baseline + 2 se")], a_file(drawn))[0].failed


@pytest.mark.parametrize(("shift", "failed"), [(-0.03, False), (0.01, False), (0.5, True)])
def test_a_model_that_became_worse_by_more_than_two_errors_is_red(shift: float, failed: bool) -> None:
    [one] = judge(a_file(one_model(shift)), [Gate.read("waic > baseline + 2 se")], a_file(one_model()))
    assert one.failed is failed


def test_what_cannot_be_compared_is_said_and_other_data_are_red() -> None:
    gate = Gate.read("waic > baseline")
    [new] = judge(a_file(one_model()), [gate], ComparisonFile(criterion="waic", studies={}, versions={}))
    assert new.failed is None
    [other] = judge(a_file(one_model()), [gate], a_file(one_model(), checksum="b"))
    assert other.failed
    assert "other data" in other.why


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("waic", "is none; give such as"),
        ("waic > much", "'much' is no number, yes or no"),
        ("wiac > 3", "unknown; did you mean 'waic'"),
        ("waic > nan", "can never fail or always does"),
        ("waic > baseline + 1e400 se", "can never fail or always does"),
        ("ess_min < yes", "can never fail or always does"),
        ("waic = yes", "waic is a number, which that cannot be compared with"),
        ("converged = 3", "converged is yes or no, which that cannot be compared with"),
        ("convergence = 3", "convergence is a text, which that cannot be compared with"),
        ("waic > baseline", "there is no baseline; give --baseline"),
        ("ess_min < baseline - 2 se", "se is that of a difference in waic; give a number"),
        ("__import__('os') > 3", "is none"),
    ],
)
def test_a_gate_that_cannot_be_used_says_why(text: str, message: str) -> None:
    with pytest.raises(GateError, match=message.replace("(", r"\(").replace(")", r"\)")):
        judge(a_file(one_model()), [Gate.read(text)])


def test_the_file_comes_back_and_damage_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    path.write_text(a_file(one_model()).to_text())
    assert read_comparison(path) == a_file(one_model())
    content = json.loads(path.read_text())
    content["studies"]["s"]["models"]["A"]["row"]["waic"] = 1.0
    path.write_text(json.dumps(content))
    with pytest.raises(GateError, match=r"c\.json: cannot be read"):
        read_comparison(path)


def test_the_reports_name_what_failed() -> None:
    now, then = a_file(one_model(0.5, converged=False)), a_file(one_model())
    judged = judge(now, [Gate.read("converged=no"), Gate.read("ess_min < 400")], then)
    suite = ElementTree.fromstring(junit(judged))[0]
    assert suite.attrib == {"name": "s", "tests": "2", "failures": "1", "skipped": "0"}
    assert [one.find("failure") is not None for one in suite] == [True, False]
    text = markdown(now, judged, then)
    assert "- **s, model A: converged=no** (converged is no)" in text
    moved, se = change(now.studies["s"].models["A"], then.studies["s"].models["A"], "waic")
    assert f"{moved:+.1f} ± {se:.1f}" in text
    assert len(text.splitlines()) < 40


def test_what_one_chain_cannot_tell_is_called_unknown() -> None:
    one = one_model()
    alone = one.model_copy(update={"row": one.row | {"rhat_max": None, "converged": False}})
    assert "| no, R-hat unknown, ESS 900 |" in markdown(a_file(alone))
    [red] = judge(a_file(one), [Gate.read("rhat_max > baseline")], a_file(alone))
    assert red.failed
    assert red.why == "rhat_max is unknown in the baseline"
