"""The report of a run: its pictures and figures on one page, ``report/index.html``."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from pathlib import Path

from docdepth import __version__
from docdepth.io.atomic import write_atomically
from docdepth.io.run_folder import RunFolder

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2em auto; max-width: 1300px; padding: 0 1em }
table { border-collapse: collapse; margin: 1em 0 }
td, th { padding: .2em 1em .2em 0; text-align: left; vertical-align: top }
figure { margin: 0 0 1em } img, video { max-width: 100% }
figcaption { color: #666; font-size: 13px }
"""


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
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{escape(title)}</title>",
        f"<style>{_STYLE}</style><h1>{escape(title)}</h1>",
        _table((), _facts(run)),
        _table(("stage", "frames", "seconds", "seconds by part"), _stages(run)),
        *(
            _pictures(report, report / folder)
            for folder in run.stage("render").get("folders", [""])
        ),
    ]
    path = report / "index.html"
    content = "\n".join(parts).encode(errors="replace")  # the name of the folder may be no text
    write_atomically(path, lambda stream: stream.write(content))
    return path


def _facts(run: RunFolder) -> Iterable[tuple[str, str]]:
    stage = run.stage("render")
    yield "recording", str(run.manifest["source"].get("dataset", "unknown"))
    yield "docdepth", f"{__version__}, preset {run.parameters.preset}"
    yield "cameras", ", ".join(stage.get("cameras", []))
    yield "renderer", str(stage.get("renderer", ""))
    if "density" in stage:
        yield "pixels with depth", f"{100 * stage['density']:.1f} %"
    if stage.get("left_out"):
        yield "images outside the sweeps, left out", ", ".join(stage["left_out"])


def _stages(run: RunFolder) -> Iterable[tuple[str, ...]]:
    for name, state in run.manifest["stages"].items():
        spent = sorted(state.get("seconds", {}).items(), key=lambda item: -item[1])
        parts = ", ".join(f"{part} {seconds:.1f}" for part, seconds in spent)
        yield name, str(state.get("frames", "")), f"{state.get('wall_seconds', 0):.1f}", parts


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = (
        ["<tr>" + "".join(f"<th>{escape(cell)}</th>" for cell in head) + "</tr>"] if head else []
    )
    for row in rows:
        lines.append("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>")
    return "<table>" + "\n".join(lines) + "</table>"


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
