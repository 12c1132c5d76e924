"""Passes of odometry in processes of their own, each a few sweeps behind the one before.

A pass is one thread by need, since sums of more would come in any order, and passes in threads of
their own do not help: both libraries of registration hold Python's lock. Of the pass before, a pass
needs no more than the poses around its sweep. So passes stand in a row, like commands with pipes
between them: each process writes its poses into its pipe and hands on what comes from before it;
the caller runs the last pass. When one ends, its pipes end, and the others with them: no process
outlives the caller by more than a sweep.
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

_LARGEST = 1 << 26  # bytes of a dataset that is sent; one that keeps its sweeps is larger
_READY = "ready"
_ENDS = (EOFError, OSError)  # of a pipe, between messages or, where a process was killed, in one
# The terminal's Ctrl-C is the caller's alone, from the first moment on.
_COMMAND = (
    "import signal, sys; signal.signal(signal.SIGINT, signal.SIG_IGN); "
    "from docdepth.odometry.parallel_passes import work; work(*map(int, sys.argv[1:]))"
)


def run_parallel(
    passes: Sequence[RegistrationPass], before: NDArray[np.float64] | None, tell: Callable[[], None]
) -> NDArray[np.float64] | None:
    """Poses of the last of these passes, all of them run at once; the same as one after the other.

    Parameters
    ----------
    passes : sequence of Pass
        Each needs the one before it.
    before : ndarray of float64, shape (n, 4, 4), optional
        Poses of the pass before the first of these.
    tell : callable
        Called after each sweep of each pass.

    Returns
    -------
    ndarray of float64, shape (n, 4, 4)
        None where other processes cannot read the dataset: it cannot be pickled, is of a class
        that only the running script knows, or keeps its sweeps in memory.

    Raises
    ------
    OdometryError
        One of the processes was killed.
    Exception
        Of any pass, as it was raised there.
    """
    workers: list[subprocess.Popen[bytes]] = []
    inlet: Connection | None = None
    try:
        for one in passes[:-1]:
            outlet, end = Pipe(duplex=False)
            with end:  # and the inlet: the copies of the workers are to be the only ones
                workers.append(_start(_packed((one, before)), end, inlet))
            if inlet is not None:
                inlet.close()
            inlet, before = outlet, None
        assert inlet is not None
        last = passes[-1]
        source = _Source(inlet, last, lambda message: _hear(message, tell))
        if not source.is_ready():
            return None
        poses = last.run(source, lambda *_: tell())
        source.drain()
        return poses
    except _CannotStart as error:
        log.debug("passes one after the other: %s", error)
        return None
    except _RowEnded:
        raise OdometryError(_fate(passes, workers)) from None
    finally:
        if inlet is not None:
            inlet.close()
        for worker in workers:
            worker.kill()
            worker.wait()


def work(send: int, receive: int | None = None) -> None:
    """What the process of one pass does; it gets the pass at its standard input."""
    try:
        one, poses = pickle.load(sys.stdin.buffer)
        one.dataset.sweep(0)
    except Exception:  # not to be read from here; the caller sees that nothing comes
        return
    out = Connection(send, readable=False)
    logging.getLogger().addHandler(_Sender(out))  # type: ignore[arg-type]
    logging.getLogger("docdepth").setLevel(logging.DEBUG)  # the caller chooses
    before: PreviousPoses | None = None if poses is None else lambda _: poses
    source = None
    try:
        if receive is not None:
            before = source = _Source(Connection(receive, writable=False), one, out.send)
            if not source.is_ready():
                return
        out.send(_READY)
        one.run(before, lambda k, pose: out.send((one.number, k, pose)))
        if source is not None:
            source.drain()
    except (BrokenPipeError, _RowEnded):
        pass
    except Exception as error:
        log.debug("pass %d", one.number + 1, exc_info=True)
        with suppress(BrokenPipeError):
            out.send(_portable(error))


class _CannotStart(Exception):
    """Passes have to run one after the other."""


class _RowEnded(Exception):
    """A pipe has ended before its poses."""


class _Source:
    """What comes from the passes before ``one``: hands all on, keeps the poses it needs."""

    def __init__(
        self, pipe: Connection, one: RegistrationPass, hand_on: Callable[[Any], None]
    ) -> None:
        self._pipe, self._number, self._hand_on = pipe, one.number - 1, hand_on
        self._count, self._known = len(one.dataset), 0
        self._poses = np.repeat(np.eye(4)[None], self._count, axis=0)

    def __call__(self, k: int) -> NDArray[np.float64]:
        while self._known <= k or (self._known < self._count and self._pipe.poll()):
            if not self._take():
                raise _RowEnded
        return self._poses

    def is_ready(self) -> bool:
        """Have the passes before got what they need? Each says so before anything else."""
        try:
            return bool(self._pipe.recv() == _READY)
        except _ENDS:
            return False

    def drain(self) -> None:
        """Hand on the rest, to the end of the pipe."""
        while self._take():
            pass

    def _take(self) -> bool:
        try:
            message = self._pipe.recv()
        except _ENDS:
            return False
        if isinstance(message, tuple) and message[0] == self._number:
            _, k, self._poses[message[1]] = message
            self._known = k + 1
        self._hand_on(message)
        return True


class _Sender(QueueHandler):
    """Log records as messages."""

    def enqueue(self, record: logging.LogRecord) -> None:
        out: Any = self.queue
        with suppress(BrokenPipeError):
            out.send(record)


class _Bounded(io.BytesIO):
    def write(self, data: Any) -> int:
        if self.tell() + memoryview(data).nbytes > _LARGEST:
            raise _CannotStart("the dataset keeps its sweeps in memory")
        return super().write(data)


def _packed(job: tuple[RegistrationPass, NDArray[np.float64] | None]) -> bytes:
    stream = _Bounded()
    try:
        pickle.dump(job, stream)
    except Exception as error:  # whatever a dataset of someone else raises
        raise _CannotStart(str(error)) from error
    return stream.getvalue()


def _start(job: bytes, end: Connection, inlet: Connection | None) -> subprocess.Popen[bytes]:
    if not sys.executable or getattr(sys, "frozen", False):
        raise _CannotStart("there is no Python to start")
    pipes = [pipe.fileno() for pipe in (end, inlet) if pipe is not None]
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
    with suppress(BrokenPipeError), worker.stdin as stdin:  # if it died, its pipe says so too
        stdin.write(job)
    return worker


def _hear(message: Any, tell: Callable[[], None]) -> None:
    """The caller's side: errors are raised, records logged, poses counted."""
    if isinstance(message, BaseException):
        raise message
    if isinstance(message, logging.LogRecord):
        logger = logging.getLogger(message.name)
        if logger.isEnabledFor(message.levelno):
            logger.handle(message)
    else:
        tell()


def _portable(error: Exception) -> Exception:
    """The error itself, if it can be sent."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return OdometryError(f"{type(error).__name__}: {error}")
    return error


def _fate(passes: Sequence[RegistrationPass], workers: Sequence[subprocess.Popen[bytes]]) -> str:
    """Who ended the row; the others end by themselves, and well."""
    remedy = "let the passes run one after the other by threads=1 (--threads 1)"
    for one, worker in zip(passes, workers, strict=False):
        with suppress(subprocess.TimeoutExpired):
            if code := worker.wait(timeout=10):
                how = f"by signal {-code}" if code < 0 else f"with code {code}"
                return (
                    f"the process of odometry's pass {one.number + 1} was ended {how}, often for "
                    f"want of memory; free some, or {remedy}"
                )
    return f"a process of odometry ended early; {remedy}"
