"""Frames kept in memory: only those that the current images need."""

from __future__ import annotations

from collections.abc import Callable, Collection
from concurrent.futures import Executor, Future
from threading import Lock

from docdepth.render.frame import Frame


class FrameCache:
    """Prepares each frame the first time it is needed and forgets it when it no longer is.

    Safe to use from several threads.

    Parameters
    ----------
    load : callable
        Prepares the frame of a sweep, given its index and whether it is needed whole; called from
        the threads of an executor.
    """

    def __init__(self, load: Callable[[int, bool], Frame]) -> None:
        self._load = load
        self._frames: dict[tuple[int, bool], Future[Frame]] = {}
        self._lock = Lock()

    def request(
        self, needed: Collection[tuple[int, bool]], executor: Executor
    ) -> dict[tuple[int, bool], Future[Frame]]:
        """Start to prepare the missing frames of ``needed``; forget all others.

        Returns
        -------
        dict of (int, bool) to Future
            The needed frames. They stay valid when another thread requests others.
        """
        with self._lock:
            kept = {i: frame for i, frame in self._frames.items() if i in needed}
            for i in sorted(needed):
                if i not in kept or _failed(kept[i]):
                    kept[i] = executor.submit(self._load, *i)
            self._frames = kept
            return dict(kept)


def _failed(frame: Future[Frame]) -> bool:
    return frame.done() and (frame.cancelled() or frame.exception() is not None)
