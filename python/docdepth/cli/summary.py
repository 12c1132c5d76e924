"""What a run has taken and given, as a table or as JSON."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from rich.table import Table

from docdepth.cli.terminal import out, volume

if TYPE_CHECKING:
    from docdepth.io.run_folder import RunFolder


def show(result: Any, as_json: bool) -> None:
    """Print metrics: their table with its legend, or all of them as JSON."""
    if as_json:
        return show_json(result.as_dict())
    out.print(str(result.table()), soft_wrap=True, markup=False)


def show_json(value: Any) -> None:
    out.print(json.dumps(value, indent=1), soft_wrap=True, markup=False)


def summary_of(folder: RunFolder) -> dict[str, Any]:
    """Seconds per stage, density, images left out and peak memory, ready for JSON."""
    stages = folder.manifest["stages"]
    kept = ("state", "frames", "wall_seconds", "seconds")
    rendered = folder.stage("render")
    return {
        "run": str(folder.path),
        "stages": {name: {k: s[k] for k in kept if k in s} for name, s in stages.items()},
        "cameras": rendered.get("cameras", []),
        "density": rendered.get("density"),
        "left_out": list(rendered.get("left_out") or []),
        "peak_memory_mb": max((s.get("peak_memory_mb", 0) for s in stages.values()), default=0),
    }


def show_summary(folder: RunFolder, as_json: bool = False) -> None:
    """Print seconds per stage, density and images left out."""
    summary = summary_of(folder)
    if as_json:
        return show_json(summary)
    if volume.quiet:
        return None
    table = Table("stage", "frames", "seconds", "ms/frame", "seconds by step", box=None)
    for name, state in summary["stages"].items():
        seconds: dict[str, float] = state.get("seconds", {})
        total, frames = state.get("wall_seconds", 0.0), state.get("frames", 0)
        parts = ", ".join(f"{k} {v:.1f}" for k, v in sorted(seconds.items(), key=lambda x: -x[1]))
        each = f"{1000 * total / frames:.0f}" if frames else ""
        table.add_row(name, str(frames), f"{total:.1f}", each, parts)
    out.print(table)
    if summary["density"] is not None:
        out.print(f"density: {100 * summary['density']:.1f} % of the pixels have depth")
    if left_out := summary["left_out"]:
        names = ", ".join(left_out)
        out.print(
            f"{len(left_out)} images outside the sweeps left out: {names}",
            soft_wrap=True,
            markup=False,
        )
    out.print(
        f"peak memory {summary['peak_memory_mb']} MB; results in {folder.path}",
        soft_wrap=True,
        markup=False,
    )
