"""Reading ``run.yaml``: inputs, parameters, cameras and the profile of each stage."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from docdepth.io.file_records import is_file_name
from docdepth.io.yaml_json import parse_yaml

SKIPPED = "skipped"
"""Entry of ``source``: broken frames that the run leaves out. ``sweeps`` by number, ``images`` by
camera and name, each with what is wrong, and ``checked``, a hash of the files that were looked at.
"""

KEPT = ("frames", "results")
"""What ``run --keep`` takes: whether the frames stay once all is done, or only the results."""

WITHOUT_FRAMES = "without_frames"
"""Entry of a run whose frames were deleted when all was done: the keys of the stages that made
them. While these are up to date, no frame is missing."""


def first_difference(have: Any, want: Any, path: str = "") -> str:
    """Say what differs first between two trees of values."""
    if isinstance(have, dict) and isinstance(want, dict):
        for key in {**have, **want}:
            if have.get(key) != want.get(key):
                return first_difference(
                    have.get(key), want.get(key), f"{path}.{key}" if path else key
                )
    if want is None:
        return f"{path} is {have!r}, and now it is not given"
    return f"{path} is {'not given' if have is None else repr(have)}, not {want!r}"


def read_manifest(path: Path) -> dict[str, Any] | None:
    """The content of run.yaml; None if it is missing or damaged."""
    try:
        found = parse_yaml(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not isinstance(found, dict) or "parameters" not in found:
        return None
    source, stages = found.get("source"), found.get("stages")
    if not isinstance(source, dict) or not isinstance(stages, dict):
        return None
    if not isinstance(found.get(WITHOUT_FRAMES, {}), dict):
        return None
    cameras = found.setdefault("cameras", {})
    sound = isinstance(cameras, dict) and all(map(_is_camera, cameras.values()))
    return found if sound and all(isinstance(stage, dict) for stage in stages.values()) else None


def _is_camera(entry: Any) -> bool:
    """Whether an entry names a folder that lies in ``depth/``, or ``depth/`` itself."""
    folder = entry.get("folder") if isinstance(entry, dict) else None
    plain = isinstance(folder, str) and (folder == "" or is_file_name(folder))
    return plain and isinstance(entry.get("settings", {}), dict)


def skipped_frames(skipped: dict[str, Any] | None) -> list[str]:
    """A sentence for each frame that a run leaves out."""
    if not skipped:
        return []
    found = [f"sweep {k}: {why}" for k, why in skipped.get("sweeps", {}).items()]
    for camera, images in skipped.get("images", {}).items():
        found += [f"image {name} of {camera}: {why}" for name, why in images.items()]
    return found


def without_skipped(source: dict[str, Any]) -> dict[str, Any]:
    """``source`` without what follows from its files: which frames are broken."""
    return {name: value for name, value in source.items() if name != SKIPPED}
