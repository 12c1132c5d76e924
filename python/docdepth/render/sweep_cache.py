"""Prepared sweeps kept in memory: only those that the current images need."""

from __future__ import annotations

from collections.abc import Callable, Collection
from concurrent.futures import Executor, Future
from threading import Lock

from docdepth.render.render_sweep import RenderSweep


class SweepCache:
    """Prepares each sweep the first time it is needed and forgets it when it no longer is.

    Safe to use from several threads.

    Parameters
    ----------
    load : callable
        Prepares a sweep, given its index and whether it is needed whole; called from
        the threads of an executor.
    """

    def __init__(self, load: Callable[[int, bool], RenderSweep]) -> None:
        self._load = load
        self._sweeps: dict[tuple[int, bool], Future[RenderSweep]] = {}
        self._lock = Lock()

    def request(
        self, needed: Collection[tuple[int, bool]], executor: Executor
    ) -> dict[tuple[int, bool], Future[RenderSweep]]:
        """Start to prepare the missing sweeps of ``needed``; forget all others.

        Returns
        -------
        dict of (int, bool) to Future
            The needed sweeps. They stay valid when another thread requests others.
        """
        with self._lock:
            kept = {i: sweep for i, sweep in self._sweeps.items() if i in needed}
            for i in sorted(needed):
                if i not in kept or _failed(kept[i]):
                    kept[i] = executor.submit(self._load, *i)
            self._sweeps = kept
            return dict(kept)


def _failed(sweep: Future[RenderSweep]) -> bool:
    return sweep.done() and (sweep.cancelled() or sweep.exception() is not None)
