"""From the sweeps of a drive to their labels: meshes, votes, objects, tracks (paper IV-C)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.concurrency import Timer, prefetch, thread_count
from docdepth.config import DynamicsParameters
from docdepth.dynamics import voting
from docdepth.dynamics.classes import Labels, classify, cluster_objects
from docdepth.dynamics.tracking import (
    TrackedSweep,
    label_by_tracks,
    local_poses,
    withdraw_untracked,
)
from docdepth.dynamics.voting import KeyFrame, KeyFrames, Votes
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.points import DYNAMIC
from docdepth.geometry.scan_mesh import ScanMesh
from docdepth.geometry.trajectory import Trajectory

_FILE_THREADS = 5
"""Threads that read and write while they add tracks: most of them wait for the disk."""


class Evidence(NamedTuple):
    """What is known of a sweep before tracks: labels by its own votes, and its objects."""

    labels: Labels
    objects: NDArray[np.uint32]  # (N,): from :func:`docdepth.dynamics.classes.cluster_objects`
    porous: NDArray[np.bool_]  # (N,): of :class:`docdepth.dynamics.voting.OccupancyIntervals`


class SweepStore(Protocol):
    """Where a drive's sweeps come from and its labels go to: memory, or a run folder.

    Methods are called from several threads.
    """

    def read(self, index: int) -> LidarFrame:
        """A sweep whose classes are ground and static."""
        ...

    def store_evidence(self, index: int, evidence: Evidence, detections: _core.Detections) -> None:
        """Store what is needed of a sweep when tracks are known, and what they are made of."""
        ...

    def evidence(self, index: int) -> Evidence: ...

    def write(self, index: int, frame: LidarFrame, labels: Labels) -> None:
        """Take the labels of a sweep."""
        ...


_Meshed: TypeAlias = tuple[LidarFrame, ScanMesh | None]
"""A sweep with its mesh, which its key frame, its objects and its classes share."""

_Needed: TypeAlias = tuple[int, Future[_Meshed], list[Future[KeyFrame]]]
"""A sweep with the key frames that vote on it."""


class SweepClassifier:
    """The steps from sweeps to their labels.

    Parameters
    ----------
    trajectory : Trajectory
        One pose a sweep.
    timer : Timer, optional
        Takes the times of the steps.

    Attributes
    ----------
    uses_tracks : bool
        Whether classes wait for tracks, which need the detections of all sweeps.
    """

    def __init__(
        self, trajectory: Trajectory, parameters: DynamicsParameters, timer: Timer | None = None
    ) -> None:
        self.uses_tracks = parameters.evidence == "tracks"
        self._key_frames = KeyFrames(trajectory, parameters)
        self._trajectory, self._parameters = trajectory, parameters
        self._timer = timer or Timer()
        self._local_poses = local_poses(trajectory)

    def vote_on(
        self,
        store: SweepStore,
        sweeps: Sequence[int],
        progress: Callable[[int], None],
        threads: int,
    ) -> None:
        """Classify sweeps by their own votes; with tracks, store their evidence.

        ``progress`` is called with the number of sweeps that are done.
        """
        # A job takes one thread, since a sweep alone has too little to do for many. Others write,
        # so that workers do not wait for the disk.
        workers = thread_count(threads)
        with ThreadPoolExecutor(2) as writers, ThreadPoolExecutor(workers) as pool:
            needed = self._look_ahead(pool, workers, store, sweeps)
            job = partial(self._classify, store, writers)
            for done, written in enumerate(prefetch(pool, job, needed, workers), 1):
                written.result()
                progress(done)

    def _look_ahead(
        self, pool: Executor, workers: int, store: SweepStore, order: Sequence[int]
    ) -> Iterator[_Needed]:
        """Each sweep with its key frames, made a little before and dropped after their last use.

        Workers take jobs in the order in which they were submitted. A job that another one needs is
        always submitted first, so no worker waits for a job that waits for a worker; and it is
        submitted some sweeps before, so workers seldom wait at all. Memory is bounded by this
        window and the radius of the key frames, not by the length of the drive.
        """
        sweeps: dict[int, Future[_Meshed]] = {}
        key_frames: dict[int, Future[KeyFrame]] = {}

        def voters(indices: Sequence[int]) -> set[int]:
            return {k for index in indices for k in self._key_frames[index].tolist()}

        for step, index in enumerate(order):
            ahead = order[step : step + workers + 2]
            soon, later = voters(ahead[: workers + 1]), voters(ahead)
            key_frames = {k: made for k, made in key_frames.items() if k in soon}
            wanted = later - key_frames.keys()
            sweeps = {k: sweep for k, sweep in sweeps.items() if k >= index or k in wanted}
            for k in sorted({*ahead, *later} - sweeps.keys() - key_frames.keys()):
                sweeps[k] = pool.submit(lambda k: self._meshed(store.read(k)), k)
            for k in sorted(soon - key_frames.keys()):
                key_frames[k] = pool.submit(self._key_frame, sweeps[k])
            yield index, sweeps[index], [key_frames[k] for k in self._key_frames[index].tolist()]

    def _meshed(self, frame: LidarFrame) -> _Meshed:
        """A sweep with its mesh, if key frames or objects need one."""
        p, rig = self._parameters, frame.sensor_rig
        if p.vote_model == "range_image" and p.evidence == "points":
            return frame, None
        # This mesh is seen from the LiDAR's place at the stamp, that of rendering from where the
        # LiDAR was when it measured each return. So they are two. Votes with moving ray origins
        # were tried: F1 0.9940 instead of 0.9941.
        if rig is not None and rig.ego_displacement is not None:
            rig = replace(rig, ego_displacement=None)
            frame = replace(frame, sensor_rig=rig)
        with self._timer("meshes"):
            return frame, ScanMesh(frame.points, rig)

    def _key_frame(self, meshed: Future[_Meshed]) -> KeyFrame:
        frame, mesh = meshed.result()
        with self._timer("key frames"):
            return KeyFrame(frame.points, frame.ground, self._parameters, mesh, frame.sensor_rig)

    def _classify(self, store: SweepStore, writers: Executor, needed: _Needed) -> Future[None]:
        """Let key frames vote on a sweep, in one thread, and hand the result to the store."""
        index, meshed, key_frames = needed
        (frame, mesh), voters = meshed.result(), self._key_frames[index]
        points, ground = frame.points, frame.ground
        poses, times = self._trajectory.poses, self._trajectory.times
        with self._timer("vote"):
            votes = voting.vote(
                points,
                ground,
                poses[index],
                [key.result() for key in key_frames],
                poses[voters],
                threads=1,
                seconds=(times[voters] - times[index]) * 1e-9,
                coarse_first=self._parameters.vote_model == "surface",
            )
        if not self.uses_tracks:
            with self._timer("objects"):
                classid = classify(ground, votes, self._parameters, points, mesh)
            return writers.submit(store.write, index, frame, Labels(classid, votes))
        mesh = mesh or ScanMesh(points)
        with self._timer("objects"):
            objects = cluster_objects(points, ground, mesh)
            classid = classify(ground, votes, self._parameters, points, mesh, objects)
        begin = self._trajectory.part(index).start
        occupancy = votes.occupancy_by_sweep(voters - begin, index - begin)
        with self._timer("detections"):
            detections = _core.Detections(
                points,
                ground,
                objects,
                classid >= DYNAMIC,
                *occupancy,
                mesh.core,
                self._local_poses[index],
                frame.time_offset,
            )
        kept = Labels(classid, Votes(votes.static, votes.dynamic))
        evidence = Evidence(kept, objects, occupancy.porous)
        return writers.submit(store.store_evidence, index, evidence, detections)

    def label_by_tracks(
        self,
        store: SweepStore,
        tracked: Sequence[TrackedSweep],
        sweeps: Sequence[int],
        progress: Callable[[int], None],
    ) -> None:
        """Classify objects that move at another time of the drive; ``tracked`` is of each sweep."""

        def add(index: int) -> None:
            # The sweep is read once more, since tracks are known when all sweeps have voted and a
            # drive may not fit into memory.
            frame, (labels, objects, porous) = store.read(index), store.evidence(index)
            found, votes = tracked[index], labels.votes
            classid, instance = labels.classid, np.zeros(len(objects), np.uint16)
            if found:
                pose, voted = self._local_poses[index], len(self._key_frames[index])
                classid, instance = label_by_tracks(
                    frame.points, objects, votes, classid, found, pose, voted
                )
            untracked = (classid >= DYNAMIC) & (instance == 0)
            classid = withdraw_untracked(
                classid, untracked, frame.ground, frame.points, votes, porous
            )
            store.write(index, frame, Labels(classid, votes, instance))

        with ThreadPoolExecutor(_FILE_THREADS) as pool:
            for done, _ in enumerate(prefetch(pool, add, sweeps, _FILE_THREADS), 1):
                progress(done)
