"""Passes of odometry run at once, each in its own process, a few sweeps behind the previous one.

A pass uses one thread, since the sums of several would come in any order. Passes in threads of one
process would not run at once either: both registration libraries hold Python's lock. A pass needs
only those poses of the previous pass that lie around its sweep, so passes form a pipeline: each
process sends its poses into a pipe and forwards what comes from the processes before it; the caller
runs the last pass. When a process ends, its pipes end, and so do the other processes: none outlives
the caller by more than a sweep.
"""

from __future__ import annotations

import io
import logging
import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from logging.handlers import QueueHandler
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import OdometryError
from docdepth.odometry.registration import PreviousPoses
from docdepth.odometry.registration_pass import RegistrationPass

log = logging.getLogger(__name__)

_LARGEST_DATASET = 1 << 26  # bytes that are pickled; a dataset that keeps its sweeps has more
_EXIT_SECONDS = 10  # how long a process whose pipe has ended may take to exit
_READY = "ready"
_PIPE_ENDED = (EOFError, OSError)  # between two messages, or within one of a killed process
# Ctrl-C reaches all processes of the terminal; only the caller handles it.
_COMMAND = (
    "import signal, sys; signal.signal(signal.SIGINT, signal.SIG_IGN); "
    "from docdepth.odometry.parallel_passes import run_worker; run_worker(*map(int, sys.argv[1:]))"
)


def run_parallel(
    passes: Sequence[RegistrationPass],
    previous: NDArray[np.float64] | None,
    on_sweep: Callable[[], None],
) -> NDArray[np.float64] | None:
    """Run consecutive passes at once; the poses are the same as of one pass after the other.

    Parameters
    ----------
    passes : sequence of RegistrationPass
        Two or more, each with the poses of the one before it.
    previous : ndarray of float64, shape (n, 4, 4), optional
        Poses of the pass before the first of these.
    on_sweep : callable
        Called after each sweep of each pass.

    Returns
    -------
    ndarray of float64, shape (n, 4, 4)
        Poses of the last pass. None where other processes cannot read the dataset: it cannot be
        pickled, its class is known to the running script only, or it keeps its sweeps in memory.

    Raises
    ------
    OdometryError
        A process was killed.
    Exception
        Of any pass, as it was raised there.
    """
    workers: list[subprocess.Popen[bytes]] = []
    inlet: Connection | None = None
    try:
        for one in passes[:-1]:
            receiver, sender = Pipe(duplex=False)
            with sender:  # closed here, so that the pipe ends with the worker; the inlet likewise
                workers.append(_start(_pickle((one, previous)), sender, inlet))
            if inlet is not None:
                inlet.close()
            inlet, previous = receiver, None
        assert inlet is not None
        last = passes[-1]
        stream = _PoseStream(inlet, last, lambda message: _handle(message, on_sweep))
        if not stream.is_ready():
            return None
        poses = last.run(stream, lambda *_: on_sweep())
        stream.drain()
        return poses
    except _CannotStart as error:
        log.debug("passes run one after the other: %s", error)
        return None
    except _StreamEnded:
        raise OdometryError(_reason_of_end(passes, workers)) from None
    finally:
        if inlet is not None:
            inlet.close()
        for worker in workers:
            worker.kill()
            worker.wait()


def run_worker(send: int, receive: int | None = None) -> None:
    """Run one pass in this process; its job is pickled at standard input.

    Parameters
    ----------
    send : int
        File descriptor for messages: that it is ready, poses, log records, an error.
    receive : int, optional
        File descriptor of the messages of the processes before this one.
    """
    try:
        one, poses = pickle.load(sys.stdin.buffer)
        one.dataset.sweep(0)
    except Exception:  # the dataset cannot be read here; the caller sees that the pipe ends
        return
    out = Connection(send, readable=False)
    logging.getLogger().addHandler(_PipeHandler(out))  # type: ignore[arg-type]
    logging.getLogger("docdepth").setLevel(logging.DEBUG)  # the caller chooses
    previous: PreviousPoses | None = None if poses is None else lambda _: poses
    stream = None
    try:
        if receive is not None:
            previous = stream = _PoseStream(Connection(receive, writable=False), one, out.send)
            if not stream.is_ready():
                return
        out.send(_READY)
        one.run(previous, lambda k, pose: out.send((one.number, k, pose)))
        if stream is not None:
            stream.drain()
    except (BrokenPipeError, _StreamEnded):
        pass
    except Exception as error:
        log.debug("pass %d", one.number + 1, exc_info=True)
        with suppress(BrokenPipeError):
            out.send(_picklable(error))


class _CannotStart(Exception):
    """The passes have to run one after the other."""


class _StreamEnded(Exception):
    """A pipe has ended before all poses came."""


class _PoseStream:
    """Poses of the previous pass as they arrive; every message is forwarded.

    Parameters
    ----------
    pipe : Connection
        Messages of all processes before this one.
    one : RegistrationPass
        The pass that needs the poses.
    forward : callable
        Called with each message.
    """

    def __init__(
        self, pipe: Connection, one: RegistrationPass, forward: Callable[[Any], None]
    ) -> None:
        self._pipe, self._number, self._forward = pipe, one.number - 1, forward
        self._count, self._known = len(one.dataset), 0
        self._poses = np.repeat(np.eye(4)[None], self._count, axis=0)

    def __call__(self, k: int) -> NDArray[np.float64]:
        """Poses of the previous pass; waits until the first k + 1 are known."""
        while self._known <= k or (self._known < self._count and self._pipe.poll()):
            if not self._receive():
                raise _StreamEnded
        return self._poses

    def is_ready(self) -> bool:
        """Whether the process before this one can read the dataset: its first message says so."""
        try:
            return bool(self._pipe.recv() == _READY)
        except _PIPE_ENDED:
            return False

    def drain(self) -> None:
        """Forward all that is left, to the end of the pipe."""
        while self._receive():
            pass

    def _receive(self) -> bool:
        """Take one message; False at the end of the pipe."""
        try:
            message = self._pipe.recv()
        except _PIPE_ENDED:
            return False
        if isinstance(message, tuple) and message[0] == self._number:
            _, k, self._poses[message[1]] = message
            self._known = k + 1
        self._forward(message)
        return True


class _PipeHandler(QueueHandler):
    """Sends log records through a pipe."""

    def enqueue(self, record: logging.LogRecord) -> None:
        out: Any = self.queue
        with suppress(BrokenPipeError):
            out.send(record)


class _LimitedBuffer(io.BytesIO):
    """Memory that refuses to grow beyond a dataset of file names."""

    def write(self, data: Any) -> int:
        if self.tell() + memoryview(data).nbytes > _LARGEST_DATASET:
            raise _CannotStart("the dataset keeps its sweeps in memory")
        return super().write(data)


def _pickle(job: tuple[RegistrationPass, NDArray[np.float64] | None]) -> bytes:
    buffer = _LimitedBuffer()
    try:
        pickle.dump(job, buffer)
    except Exception as error:  # a dataset of the user's own may raise anything
        raise _CannotStart(str(error)) from error
    return buffer.getvalue()


def _start(job: bytes, sender: Connection, inlet: Connection | None) -> subprocess.Popen[bytes]:
    """Start the process of a pass with its pipes, and give it its job."""
    if not sys.executable or getattr(sys, "frozen", False):
        raise _CannotStart("there is no Python to start")
    pipes = [pipe.fileno() for pipe in (sender, inlet) if pipe is not None]
    try:
        worker = subprocess.Popen(
            [sys.executable, "-c", _COMMAND, *map(str, pipes)],
            stdin=subprocess.PIPE,
            pass_fds=pipes,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(p or os.getcwd() for p in sys.path)},
        )
    except OSError as error:
        raise _CannotStart(str(error)) from error
    assert worker.stdin is not None
    with suppress(BrokenPipeError), worker.stdin as stdin:  # if it died, its pipe ends too
        stdin.write(job)
    return worker


def _handle(message: Any, on_sweep: Callable[[], None]) -> None:
    """In the caller: raise errors, log records, count poses."""
    if isinstance(message, BaseException):
        raise message
    if isinstance(message, logging.LogRecord):
        logger = logging.getLogger(message.name)
        if logger.isEnabledFor(message.levelno):
            logger.handle(message)
    else:
        on_sweep()


def _picklable(error: Exception) -> Exception:
    """The error itself, or its text where it cannot be sent."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return OdometryError(f"{type(error).__name__}: {error}")
    return error


def _reason_of_end(
    passes: Sequence[RegistrationPass], workers: Sequence[subprocess.Popen[bytes]]
) -> str:
    """Which process failed; the others end by themselves, with code 0."""
    remedy = "run the passes one after the other with threads=1 (--threads 1)"
    for one, worker in zip(passes, workers, strict=False):
        with suppress(subprocess.TimeoutExpired):
            if code := worker.wait(timeout=_EXIT_SECONDS):
                how = f"by signal {-code}" if code < 0 else f"with code {code}"
                return (
                    f"the process of odometry's pass {one.number + 1} was ended {how}, often for "
                    f"want of memory; free some, or {remedy}"
                )
    return f"a process of odometry ended early; {remedy}"
