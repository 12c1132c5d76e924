"""What stays of a run that is done: all of it, or only its results, without the frames.

Frames are four fifths of a run's bytes, and those who want depth maps alone never open them. They
can be made again while the recording is there: poses, ground and tracks stay.
"""

from __future__ import annotations

from docdepth.io.manifest import Keep
from docdepth.io.run_folder import RunFolder


def choose_kept(run: RunFolder, keep: Keep | None) -> None:
    """Note what stays once all is done; as before if it is None."""
    run.manifest.keep = keep or run.manifest.keep
    if not keeps_only_results(run):
        run.manifest.frames_deleted = None  # so its frames are missing


def keeps_only_results(run: RunFolder) -> bool:
    """Whether the frames of a run are deleted once all is done."""
    return run.manifest.keep == "results"


def delete_frames(run: RunFolder) -> None:
    """Delete the frames of a run that is done, or what an interrupted command left of them."""
    run.manifest.frames_deleted = {name: run.stage(name).key for name in ("odometry", "classify")}
    run.save()  # before the first is gone: a run that is interrupted here misses none
    for folder in run.frame_path(0).parent, run.classes_path(0).parent:
        records = run.records(folder)
        for name in records.names():
            run.remove(folder / name)
        records.compact()
