"""What stays of a run that is done: all of it, or only its results, without the frames.

Frames are four fifths of a run's bytes, and those who want depth maps alone never open them. They
can be made again while the recording is there: poses, ground and tracks stay.
"""

from __future__ import annotations

from docdepth.errors import ConfigError
from docdepth.io.manifest import KEPT, WITHOUT_FRAMES
from docdepth.io.run_folder import RunFolder

_KEEP = "keep"
"""Entry of run.yaml: one of ``KEPT``."""


def choose_kept(run: RunFolder, keep: str | None) -> None:
    """Note what stays once all is done: one of ``KEPT``; as before if it is None.

    Raises
    ------
    ConfigError
        It is neither.
    """
    if keep not in (None, *KEPT):
        raise ConfigError(f"keep is {keep!r}; it must be {' or '.join(KEPT)}")
    if keep is not None:
        run.manifest[_KEEP] = keep
    if not keeps_only_results(run):
        run.manifest.pop(WITHOUT_FRAMES, None)  # so its frames are missing


def keeps_only_results(run: RunFolder) -> bool:
    """Whether the frames of a run are deleted once all is done."""
    return bool(run.manifest.get(_KEEP) == "results")


def delete_frames(run: RunFolder) -> None:
    """Delete the frames of a run that is done, or what an interrupted command left of them."""
    made = ("odometry", "classify")
    run.manifest[WITHOUT_FRAMES] = {stage: run.stage(stage).get("key") for stage in made}
    run.save()  # before the first is gone: a run that is interrupted here misses none
    folder = run.frame_path(0).parent
    records = run.records(folder)
    for name in records.names():
        run.remove(folder / name)
    records.compact()
