"""States of a run as files of arrays and JSON, with a digest: nothing of them is ever run.

A file is a line with the SHA-256 of all that follows, then an archive of NumPy's (npz): its arrays, and as
"content" the JSON that they belong into.
"""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from pymc.step_methods import metropolis as of_pymc
from pymc.step_methods.hmc import quadpotential as metrics
from pymc.step_methods.step_sizes import StepSizeState
from pymc.util import RandomGeneratorState

from zoo.core.digests import of_bytes
from zoo.core.inference.logposterior import SamplingError
from zoo.core.inference.mode import Mode
from zoo.core.inference.spaces import Archive, ConstrainedSpace, Gaussian
from zoo.core.inference.starts import Start
from zoo.core.inference.steps import Walk
from zoo.core.outputs import write_file

_GENERATORS = ("PCG64", "PCG64DXSM", "MT19937", "Philox", "SFC64")
REMEDY = "remove the folder to start afresh"
_ARRAYS = "biufcUS"  # kinds of dtypes that are nothing but numbers or text


class CheckpointError(SamplingError):
    """A checkpoint folder belongs to another run, is in use, or cannot be read."""


@dataclass(frozen=True)
class _Stored:
    """A type that states hold: how it becomes plain content, and how it is made again from that."""

    fields: Callable[[Any], Mapping[str, Any]]
    make: Callable[..., Any]


def _fields(*names: str) -> Callable[[Any], Mapping[str, Any]]:
    return lambda value: {name: getattr(value, name) for name in names}


def _filled(kind: type, names: tuple[str, ...]) -> Callable[..., Any]:
    """Makes an object from its attributes alone: what was computed once is not computed again."""

    def make(**content: Any) -> Any:
        made: Any = object.__new__(kind)
        for name in names:
            object.__setattr__(made, name, content[name])
        return made

    return make


def _generator(bit_generator_state: dict[str, Any], seed_seq_state: dict[str, Any]) -> RandomGeneratorState:
    if bit_generator_state["bit_generator"] not in _GENERATORS:
        raise ValueError("an unknown generator of random numbers")
    return RandomGeneratorState(bit_generator_state, seed_seq_state)


def _plain(kind: type, *names: str) -> tuple[type, _Stored]:
    return kind, _Stored(_fields(*names), _filled(kind, names))


_PROPOSALS = ("NormalProposal", "UniformProposal", "CauchyProposal", "LaplaceProposal", "PoissonProposal")
_OF_NUTS = (StepSizeState, metrics.QuadPotentialFullAdaptState, metrics.WeightedCovarianceState)
_TYPES: dict[type, _Stored] = dict(
    [
        (Archive, _Stored(_fields("points"), Archive)),
        (RandomGeneratorState, _Stored(_fields("bit_generator_state", "seed_seq_state"), _generator)),
        _plain(Gaussian, "mean", "covariance", "cholesky"),
        _plain(ConstrainedSpace, "index", "lower", "width"),
        _plain(Walk, "space", "reference", "beta", "tuned"),
        _plain(Mode, "vector", "values", "logp", "covariance", "evaluations"),
        _plain(Start, "starts", "reference", "archive", "mode"),
        _plain(of_pymc.MultivariateNormalProposal, "n", "chol"),
        *(_plain(getattr(of_pymc, name), "s") for name in _PROPOSALS),
        *(_plain(kind, *(field.name for field in fields(kind))) for kind in _OF_NUTS),
    ]
)
_BY_NAME = {kind.__name__: stored for kind, stored in _TYPES.items()}


def write_state(path: Path, owner: Mapping[str, Any], content: Mapping[str, Any]) -> float:
    """Replace a file in one go: a kill at any moment leaves the old one or the new one.

    Parameters
    ----------
    path : Path
    owner : mapping
        Run and part that the content belongs to, in words.
    content : mapping
        Numbers, texts, arrays, lists, tables, and the types of the step methods.

    Returns
    -------
    float
        Time (that of time.monotonic, in s) from which the wait for the next write counts: so late that
        writing never takes more than a twentieth of a run.

    Raises
    ------
    SamplingError
        If something of it is of another type.
    zoo.core.outputs.OutputFileError
        If the file cannot be written.
    """
    began = time.monotonic()
    arrays: dict[str, np.ndarray] = {}
    text = json.dumps({"owner": dict(owner), "content": _packed(dict(content), arrays)})
    archive = io.BytesIO()
    np.savez(archive, content=np.frombuffer(text.encode(), dtype=np.uint8), **arrays)  # type: ignore[arg-type]
    body = archive.getvalue()
    write_file(path, of_bytes(body).encode() + b"\n" + body)
    return time.monotonic() + 20 * (time.monotonic() - began)


def read_state(path: Path, owner: Mapping[str, Any]) -> dict[str, Any]:
    """Read back what `write_state` wrote.

    Raises
    ------
    CheckpointError
        If the file does not fit its digest, is of another run or part, or holds something else.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise CheckpointError(f"{path}: cannot be read ({error.strerror}); {REMEDY}") from None
    digest, _, body = raw.partition(b"\n")
    if digest != of_bytes(body).encode():
        raise CheckpointError(f"{path}: damaged, its content does not fit its digest; {REMEDY}")
    try:
        with np.load(io.BytesIO(body), allow_pickle=False) as archive:
            found = json.loads(archive["content"].tobytes())
            theirs = found["owner"]
            content = _unpacked(found["content"], archive) if theirs == dict(owner) else {}
        assert isinstance(content, dict)
    except Exception as error:  # the digest fits, so that someone wrote it so
        reason = f"{type(error).__name__}: {error}".splitlines()[0][:200]
        raise CheckpointError(f"{path}: is no state of a run ({reason}); {REMEDY}") from None
    if theirs != dict(owner):
        raise CheckpointError(f"{path}: belongs to another run or another chain of it; {REMEDY}")
    return content


def of_chain(run: str, chain: int) -> dict[str, str]:
    """Owner of a chain's state; the run by the digest of what is being run."""
    return {"run": run, "part": f"chain {chain}"}


def _packed(value: Any, arrays: dict[str, np.ndarray]) -> Any:
    """A value as JSON, its arrays set aside under numbers."""
    if value is None or type(value) in (bool, int, float, str):
        return value
    if isinstance(value, np.ndarray | np.generic) and value.dtype.kind in _ARRAYS:
        name = f"array-{len(arrays)}"
        arrays[name] = np.asarray(value)
        return {"scalar" if isinstance(value, np.generic) else "array": name}
    if isinstance(value, bytes):
        return {"bytes": value.hex()}
    if type(value) is list:
        return [_packed(item, arrays) for item in value]
    if type(value) is tuple:
        return {"tuple": [_packed(item, arrays) for item in value]}
    if isinstance(value, dict):
        return {"table": [[_packed(k, arrays), _packed(v, arrays)] for k, v in value.items()]}
    if type(value) not in _TYPES:
        raise SamplingError(
            f"a {type(value).__name__} in the state of a chain cannot be stored in a checkpoint; use one of "
            "PyMC's types, or sample without a checkpoint"
        )
    return {
        "type": type(value).__name__,
        "fields": _packed(dict(_TYPES[type(value)].fields(value)), arrays),
    }


def _unpacked(value: Any, arrays: Mapping[str, np.ndarray]) -> Any:
    if isinstance(value, list):
        return [_unpacked(item, arrays) for item in value]
    if not isinstance(value, dict):
        return value
    if "type" in value:
        return _BY_NAME[value["type"]].make(**_unpacked(value["fields"], arrays))
    [(kind, inner)] = value.items()
    if kind == "array":
        return arrays[inner]
    if kind == "scalar":
        return arrays[inner][()]
    if kind == "bytes":
        return bytes.fromhex(inner)
    if kind == "tuple":
        return tuple(_unpacked(item, arrays) for item in inner)
    if kind == "table":
        return {_unpacked(k, arrays): _unpacked(v, arrays) for k, v in inner}
    raise ValueError(f"an unknown kind {kind!r}")
