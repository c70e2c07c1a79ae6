"""A chain in a process of its own, and its parent's side of the pipe between them."""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from subprocess import _args_from_interpreter_flags as args_from_interpreter_flags  # type: ignore[attr-defined]
from typing import IO, Any

from zoo.core.inference.chain import Chain

_ONE_THREAD = dict.fromkeys(
    (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "VECLIB_MAXIMUM_THREADS",
        "NUMEXPR_NUM_THREADS",
    ),
    "1",
)
# Not multiprocessing: its spawn and forkserver import the caller's script again, which a script that samples
# without `if __name__ == "__main__"` does not survive. With -P the working folder is not searched for modules
# (a json.py beside the data would be run); then the path becomes the parent's.
_BOOT = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from zoo.core.inference.processes import worker_main; worker_main()"
)


def worker_main() -> None:
    """Main function of a chain's process: task and commands come on stdin, progress goes out on stdout."""
    with contextlib.suppress(ValueError):
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides what an interrupt means
    source = os.fdopen(os.dup(0), "rb")
    sink = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever prints must not mix with the messages
    status = 0
    try:
        _serve(source, sink)
    except (BrokenPipeError, EOFError):
        status = 1  # the parent is gone, and the checkpoint is written
    finally:
        sys.stderr.flush()
        os._exit(status)  # the reading thread may be blocked: no orderly shutdown


def _serve(source: IO[bytes], sink: IO[bytes]) -> None:
    def send(kind: str, content: Any) -> None:
        pickle.dump((kind, content), sink, protocol=5)
        sink.flush()

    commands: queue.Queue[tuple[int, float | None] | None] = queue.Queue()
    stop = threading.Event()

    def read() -> None:
        with contextlib.suppress(EOFError, OSError, pickle.UnpicklingError):
            while True:
                commands.put(pickle.load(source))
        stop.set()  # the parent closed the pipe, or died
        commands.put(None)

    chain: Chain | None = None
    try:
        task = pickle.load(source)
        threading.Thread(target=read, daemon=True).start()
        chain = Chain(task)
        sent = 0
        told = 0.0

        def tick() -> None:
            nonlocal sent, told
            now = time.monotonic()
            if now - told >= 1.0:
                report("running")
                told = now

        def report(kind: str) -> None:
            nonlocal sent
            content = chain.since(sent)
            sent = chain.kept
            send(kind, content)

        report("ready")
        while (command := commands.get()) is not None:
            chain.run(*command, tick, stop.is_set)
            if not stop.is_set():
                report("paused")
        chain.save()
        send("stopped", None)
    except BrokenPipeError:
        if chain is not None:
            chain.save()
        raise
    except Exception as error:
        text = traceback.format_exc()
        with contextlib.suppress(BrokenPipeError):
            send("failed", (f"{type(error).__name__}: {error}", text))


class Worker:
    """Parent's side of a chain's process."""

    def __init__(self, chain: int, payload: bytes, inbox: queue.Queue[Any]) -> None:
        self.chain = chain
        self.inbox = inbox
        self.errors = tempfile.TemporaryFile()  # noqa: SIM115 (closed by wait)
        self.process = subprocess.Popen(
            [sys.executable, *args_from_interpreter_flags(), "-P", "-c", _BOOT, json.dumps(sys.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.errors,
            env={**os.environ, **_ONE_THREAD},
        )
        threading.Thread(target=self._read, args=(payload,), daemon=True).start()

    def _send(self, message: bytes) -> None:
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # its end is reported by the reading thread
            self.process.stdin.write(message)
            self.process.stdin.flush()

    def _read(self, payload: bytes) -> None:
        assert self.process.stdout is not None
        self._send(payload)  # here, because it takes until the process has imported PyMC
        try:
            while True:
                kind, content = pickle.load(self.process.stdout)
                self.inbox.put((self.chain, kind, content))
        except (EOFError, pickle.UnpicklingError, OSError, ValueError):
            self.inbox.put((self.chain, "ended", None))

    def run(self, until: int, seconds: float | None) -> None:
        """Ask for more draws."""
        self._send(pickle.dumps((until, seconds)))

    def close(self) -> None:
        """Ask the process to write its checkpoint and end."""
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError, OSError):
            self.process.stdin.close()

    def wait(self, seconds: float) -> None:
        """Wait for the end; kill after that."""
        try:
            self.process.wait(seconds)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.errors.close()

    def last_words(self) -> str:
        """Last line that the process wrote to its standard error."""
        self.errors.seek(0)
        lines = self.errors.read().decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else ""
