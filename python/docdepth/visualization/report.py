"""The report of a run: one page that shows what was made and how, ``report/index.html``."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from docdepth._core import __version__
from docdepth._text import described
from docdepth.config import STAGES, Parameters
from docdepth.datasets.base import CameraStream
from docdepth.errors import RunError
from docdepth.geometry.track import KINDS, Track
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import tracks_in
from docdepth.io.untrusted import read_text
from docdepth.visualization import drive_map
from docdepth.visualization.image_views import CONFIDENCE_COLORS, DOUBTFUL, SEEN_COLORS
from docdepth.visualization.page import (
    FLIP_STYLE,
    depth_scale,
    head,
    image_flipper,
    scale,
    scripts,
    swatches,
    table,
)
from docdepth.visualization.pictures import (
    BACKGROUND,
    DYNAMIC_COLOR,
    GROUND_COLOR,
    STATIC_COLOR,
    TRACK_COLORS,
)
from docdepth.visualization.report_images import CameraPage, camera_pages

log = logging.getLogger(__name__)

HELD_OUT = "held_out.json"
"""File in a camera's folder of ``report/``: its errors against sweeps that were left out."""

_STYLE = (
    drive_map.STYLE
    + FLIP_STYLE
    + """
.warnings { border-left: 4px solid #d55e00; padding: .2em 1em; background: var(--alert) }
.bar { display: flex; height: 1.1em; background: var(--fill);
  width: clamp(70px, 30vw - 40px, 420px) } .bar i { background: var(--accent) }
.chart { display: grid; grid-template-columns: auto 1fr; gap: 0 .5em; font-size: 13px }
.chart div { display: flex; flex-direction: column; justify-content: space-between }
.chart .x { flex-direction: row }
.chart svg { width: 100%; height: 90px; border: 1px solid var(--line) }
.chart polyline { fill: none; stroke: var(--accent); stroke-width: 2px;
  vector-effect: non-scaling-stroke } .times td:not(.note) { white-space: nowrap }
.times .note { min-width: 300px } .times th { white-space: nowrap }
.facts td { overflow-wrap: anywhere; min-width: 6em }
"""
)
_BELOW = " ({:.1%} of those below the horizon)"
_DENSITIES = 2000  # points of the curve of a camera
_VIEWS = {
    "depth": "depth",  # the page opens with what it is about
    "image": "image",
    "class": "classes and tracks",
    "confidence": "confidence",
    "seen": "seen by rays",
    "instance": "instances",
}


def index_is_whole(run: RunFolder) -> bool:
    """Whether the page is there as it was written."""
    return run.records(run.path / "report").state("index.html") == "whole"


def write_report(run: RunFolder, streams: Mapping[str, CameraStream]) -> Path:
    """Write ``report/index.html``: pictures, figures and parameters of a run in one file.

    The file needs nothing else and stays below 15 MB however long the drive is.

    Parameters
    ----------
    run : RunFolder
        With classified frames; cameras without depth maps are left out.
    streams : mapping of str to CameraStream
        Cameras by name; without one its images are left out.
    """
    trajectory = run.trajectory()
    tracks = list(tracks_in(run.path).values())
    cameras = list(camera_pages(run, streams, tracks))
    parts = [
        head(f"docdepth: {run.path.resolve().name}", _STYLE),
        f"<p>{escape(_summary(run, trajectory, tracks, cameras))}</p>",
        _warnings(run),
        *(_camera(run, page, trajectory) for page in cameras),
        "<h2>The drive from above</h2>",
        drive_map.map_section(drive_map.drive_map(run), trajectory, tracks),
        "<h2>Time</h2>",
        _time(run),
        "<h2>Parameters</h2>",
        _parameters(run.parameters),
        "<h2>Inputs</h2>",
        f"<div class=facts>{table((), _inputs(run))}</div>",
        scripts(["report.js"]),
    ]
    path = run.path / "report" / "index.html"
    content = "\n".join(parts).encode(errors="replace")  # the name of the folder may be no text
    run.write(path, content, {})
    return path


def keep_held_out(run: RunFolder, camera: str | None, errors: Mapping[str, Any]) -> bool:
    """Keep errors against held-out sweeps; the report shows them as long as the depth stays.

    Nothing is kept in a folder without depth maps of docdepth. Where the folder cannot be written,
    a warning says so.

    Parameters
    ----------
    errors : mapping
        A table: ``title``, ``header``, ``rows`` and ``note``, all texts.
    """
    folder = run.depth_folder(camera)
    made_of = run.stage(f"render {run.camera_in(folder)}").key
    if made_of is None:
        return False
    content = json.dumps(errors, indent=1).encode()
    path = run.path / "report" / folder / HELD_OUT
    try:
        with run.lock("evaluate"):
            run.write(path, content, {"render": made_of})
    except (OSError, RunError) as error:
        log.warning("the errors are not kept for the report: %s", error)
        return False
    return True


def _summary(
    run: RunFolder, trajectory: Trajectory, tracks: Sequence[Track], cameras: Sequence[CameraPage]
) -> str:
    seconds = float(trajectory.times[-1] - trajectory.times[0]) * 1e-9
    kinds = [(kind, sum(track.kind == kind for track in tracks)) for kind in KINDS]
    objects = ", ".join(
        f"{count} {kind}{'s' if count > 1 and kind != 'other' else ''}"
        for kind, count in kinds
        if count
    )
    recording = (run.recording_path or Path("unknown recording")).name
    parts = [
        f"{recording}: {len(trajectory)} sweeps in {seconds:.1f} s, "
        f"{trajectory.arc_length[-1]:.0f} m driven",
        f"{len(tracks)} moving objects" + f" ({objects})" * bool(tracks),
    ]
    for page in cameras:
        mean = np.mean([share for _, share in page.density])
        below = "" if np.isnan(page.below_horizon) else _BELOW.format(page.below_horizon)
        parts.append(
            f"{len(page.density)} depth maps of {page.name}, {mean:.1%} of pixels filled{below}"
        )
    return "; ".join(parts) + "."


def _warnings(run: RunFolder) -> str:
    found = [("inputs", text) for text in run.manifest.warnings]
    for name, stage in run.manifest.stages.items():
        found += [(name, text) for text in stage.warnings]
        if left := stage.left_out:
            few = (
                ", ".join(left) if len(left) <= 10 else f"{len(left)} from {left[0]} to {left[-1]}"
            )
            found.append((name, f"images outside the sweeps, left out: {few}"))
    if (skipped := run.manifest.derived.skipped) is not None:
        found += [("left out", text) for text in skipped.sentences()]
    if not found:
        return "<p>No warnings.</p>"
    lines = (f"<li><b>{escape(name)}</b>: {escape(text)}" for name, text in found)
    return f"<div class=warnings>Warnings<ul>{''.join(lines)}</ul></div>"


def _camera(run: RunFolder, page: CameraPage, trajectory: Trajectory) -> str:
    """Images of a camera to flip between, its density and its held-out errors."""
    within = sum(bool(image.views) for image in page.images)
    note = f"{within} of {len(page.images)} images with all views"
    bare = not any("image" in image.views for image in page.images)
    no_photos = "No photos of this camera are at hand, so classes are drawn on black."
    verdict = run.stage(f"render {page.name}").calibration
    fit = run.cameras[page.name].fit if page.name in run.cameras else None
    asked = f"<p>Camera: {escape(fit.verdict)}.</p>" if fit and fit.verdict else ""
    edges = f"<p>Depth edges against image edges: {escape(verdict)}.</p>" if verdict else ""
    return "\n".join([
        f"<section class=camera><h2>Camera {escape(page.name)}</h2>"
        + f"<p class=note>{no_photos}</p>" * bare,
        image_flipper(page.images, _VIEWS, _legends(), note),
        _density(page.density, int(trajectory.times[0])),
        asked + edges,
        _held_out(run, page.name),
        "</section>",
    ])  # fmt: skip


def _legends() -> dict[str, str]:
    """What stands below the pictures of a view."""
    no_depth = swatches([([(BACKGROUND,) * 3], "no depth")])
    middle = (1 + DOUBTFUL) / 2
    marks = [(0.0, f"{DOUBTFUL:g} or less"), (0.5, f"{middle:g}"), (1.0, "1: depth is right")]
    seen = ("no ray near this time", "a ray agrees", "a ray contradicts the depth")
    return {
        "depth": depth_scale() + no_depth,
        "class": swatches([
            ([GROUND_COLOR], "ground"),
            ([STATIC_COLOR], "static"),
            ([DYNAMIC_COLOR], "moving"),
            (TRACK_COLORS, "boxes of moving objects, with their numbers"),
        ]),
        "confidence": scale(CONFIDENCE_COLORS[::16], marks) + no_depth,
        "seen": swatches([([color], text) for color, text in zip(SEEN_COLORS, seen, strict=True)]),
        "instance": swatches([(TRACK_COLORS, "moving objects; dark: all that stands")]),
    }  # fmt: skip


def _density(density: Sequence[tuple[int, float]], start: int) -> str:
    """Share of pixels with depth over time, from 0 to 100 %."""
    drawn = drive_map.thinned(
        np.array([((t - start) * 1e-9, 100 - 100 * s) for t, s in density]), _DENSITIES
    )
    points = " ".join(f"{seconds:.3f},{missing:.2f}" for seconds, missing in drawn)
    first, last = ((density[k][0] - start) * 1e-9 for k in (0, -1))
    shares = [share for _, share in density]
    return (
        f"<p>Pixels with depth: {np.mean(shares):.1%} on average, {min(shares):.1%} to "
        f"{max(shares):.1%}</p><div class=chart><div><span>100 %</span><span>0 %</span></div>"
        f'<svg viewBox="{first:.3f} 0 {max(last - first, 0.001):.3f} 100" '
        f'preserveAspectRatio=none><polyline points="{points}"/></svg>'
        f"<div></div><div class=x><span>{first:.1f} s</span><span>{last:.1f} s</span></div></div>"
    )


def _held_out(run: RunFolder, camera: str) -> str:
    path = run.path / "report" / run.cameras[camera].folder / HELD_OUT
    if run.key(path) != {"render": run.stage(f"render {camera}").key}:
        return (
            "<p class=note>Errors against sweeps that were left out are not measured yet: docdepth "
            "evaluate held-out RUN does it, and adds them here</p>"
        )
    kept = json.loads(read_text(path))
    rows = (tuple(row) for row in kept["rows"])
    return (
        f"<h3>{escape(kept['title'])}</h3>{table(tuple(kept['header']), rows)}"
        f"<p class=note>{escape(kept['note'])}</p>"
    )


def _time(run: RunFolder) -> str:
    """Seconds of each stage, as bars, with its parts."""
    stages = run.manifest.stages
    totals = {name: entry.total_seconds for name, entry in stages.items()}
    longest = max(totals.values(), default=0.0) or 1.0
    rows = []
    for name, state in stages.items():
        spent = sorted(state.seconds.items(), key=lambda item: -item[1])
        parts = ", ".join(f"{part} {seconds:.1f}" for part, seconds in spent)
        frames = state.all_frames
        each = f"{totals[name] / frames:.2f} s" if frames else ""
        rows.append(
            f"<tr><td>{escape(name)}<td><div class=bar><i style='width:"
            f"{100 * totals[name] / longest:.1f}%'></i></div><td>{totals[name]:.1f} s<td>{frames}"
            f"<td>{each}<td class=note>{escape(parts)}"
        )
    header = ("stage", "", "time", "frames", "a frame", "parts [s], several at a time")
    return (
        f"<table class=times><tr>{''.join(f'<th>{name}' for name in header)}{''.join(rows)}</table>"
    )


def _parameters(chosen: Parameters) -> str:
    rows = []
    for stage, model in STAGES.items():
        for name, field in model.model_fields.items():
            value, default = getattr(getattr(chosen, stage), name), field.default
            if value != default:
                about = described(field)
                unit = f" {about.unit}" if about.unit else ""
                values = f"{_shown(value)}{unit}", f"{_shown(default)}{unit}"
                rows.append((f"{stage}.{name}", *values, about.description))
    if not rows:
        return f"<p>Preset {escape(chosen.preset)}; every parameter has its default.</p>"
    header = ("parameter", "value", "default", "what it is")
    return f"<p>Preset {escape(chosen.preset)}; these differ from the default.</p>" + table(
        header, rows
    )


def _shown(value: Any) -> str:
    return ", ".join(map(str, value)) or "none" if isinstance(value, list | tuple) else f"{value}"


def _inputs(run: RunFolder) -> Iterator[tuple[str, str]]:
    yield "docdepth", __version__
    found = [run.manifest.derived.model_dump(mode="json", exclude={"skipped"})]
    if run.manifest.inputs is not None:
        found.insert(0, run.manifest.inputs.model_dump(mode="json"))
    shown = ((name, value) for tree in found for name, value in tree.items() if value)
    yield from ((name, _shown(value)) for name, value in shown)
    for name in run.cameras:
        yield f"renderer of {name}", run.stage(f"render {name}").renderer or ""
