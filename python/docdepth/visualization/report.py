"""The report of a run: its pictures and figures on one page, ``report/index.html``."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from pathlib import Path

from docdepth import __version__
from docdepth.io.run_folder import RunFolder
from docdepth.visualization.page import head, table


def index_is_whole(run: RunFolder) -> bool:
    """Whether the page is there as it was written."""
    return run.records(run.path / "report").state("index.html") == "whole"


def write_index(run: RunFolder) -> Path:
    """Write ``report/index.html``, which shows the files in ``report/``.

    Parameters
    ----------
    run : RunFolder

    Returns
    -------
    Path
        Of the page.
    """
    report = run.path / "report"
    title = f"docdepth: {run.path.resolve().name}"
    parts = [
        head(title),
        table((), _facts(run)),
        table(("stage", "frames", "seconds", "seconds by part"), _stages(run)),
        *(_pictures(report, report / str(camera["folder"])) for camera in run.cameras.values()),
    ]
    path = report / "index.html"
    content = "\n".join(parts).encode(errors="replace")  # the name of the folder may be no text
    run.write(path, lambda stream: stream.write(content), {})
    return path


def _facts(run: RunFolder) -> Iterable[tuple[str, str]]:
    yield "recording", str(run.manifest["source"].get("dataset", "unknown"))
    yield "docdepth", f"{__version__}, preset {run.parameters.preset}"
    for name in run.cameras:
        stage = run.stage(f"render {name}")
        density = f", {100 * stage['density']:.1f} % of the pixels" if "density" in stage else ""
        yield f"depth of {name}", f"{stage.get('all_frames', 0)} images{density}"
        if stage.get("left_out"):
            yield "images outside the sweeps, left out", ", ".join(stage["left_out"])
        yield f"renderer of {name}", str(stage.get("renderer", ""))
    for text in run.manifest.get("warnings", []):
        yield "warning of the inputs", text
    for name, stage in run.manifest["stages"].items():
        for text in stage.get("warnings", []):
            yield f"warning of {name}", text


def _stages(run: RunFolder) -> Iterable[tuple[str, ...]]:
    for name, state in run.manifest["stages"].items():
        spent = sorted(state.get("seconds", {}).items(), key=lambda item: -item[1])
        parts = ", ".join(f"{part} {seconds:.1f}" for part, seconds in spent)
        spent_in_all = f"{state.get('total_seconds', state.get('wall_seconds', 0)):.1f}"
        yield name, str(state.get("all_frames", "")), spent_in_all, parts


def _pictures(report: Path, folder: Path) -> str:
    lines = [f"<h2>{escape(folder.name)}</h2>"] if folder != report else []
    if (folder / "video.webm").is_file():
        link = escape((folder / "video.webm").relative_to(report).as_posix())
        lines.append(f'<p><video controls loop preload=metadata src="{link}"></video></p>')
    for picture in sorted(folder.glob("*.jpg")):
        link = escape(picture.relative_to(report).as_posix())
        lines.append(
            f'<figure><img loading=lazy src="{link}" alt=""><figcaption>{escape(picture.stem)}'
            "</figcaption></figure>"
        )
    return "\n".join(lines)
