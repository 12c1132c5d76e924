"""The page of a recording: what it holds, what is wrong with it, and pictures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Any

from docdepth._core import __version__
from docdepth.visualization.inspection_text import inspection_lines
from docdepth.visualization.page import figure, head, table, write_page
from docdepth.visualization.pictures import Picture

_COLORS = {"error": "#b00020", "warning": "#a05a00", "note": "#555"}
_UNITS = {"_m_s": "m/s", "_m": "m", "_ns": "ns", "_s": "s", "_hz": "Hz", "_deg": "degrees"}
_MEANINGS = {
    "sweeps": "stamps of the sweeps",
    "lidars": "of a sweep from the middle; range: least, median, 99 % and largest; spacing: along "
    "beams and across them; same ray, same point: shares of points with another one there",
    "rows": "largest share of the rows of a sweep: not finite, at the origin, close to it (below "
    "half a metre), in one other place",
    "point_times": "span: first and last point after the stamp, in sweeps; turn: azimuth from one "
    "point to the next in time",
    "ground": "tilt: angle between z and the ground's normal (up); height of the frame's origin",
    "poses": "speed: median and largest; turn from sweep to sweep",
    "registered": "motion that sweeps show without poses",
    "ego": "points that stay with the LiDAR while it moves: its vehicle, and mirror images of it",
    "cameras": "field of view: horizontal; starts and ends: after the sweeps",
}


def write_inspection(
    path: Path,
    figures: dict[str, Any],
    findings: Sequence[tuple[str, str]],
    pictures: Iterable[tuple[Picture, str]],
) -> None:
    """Write the page, in one file that needs nothing else.

    Parameters
    ----------
    path : Path
        A page that docdepth wrote is replaced, no other file.
    figures : dict
        Groups of figures by name: a dict, a list of dicts with the same keys, or None.
    findings : sequence of (str, str)
        Errors, warnings and notes, each with its severity.
    pictures : iterable of (ndarray of uint8, str)
        With captions.

    Raises
    ------
    DatasetError
        There is another file, or none can be written.
    """
    title = f"docdepth: {Path(figures['recording']['path']).resolve().name}"
    parts = [head(title), *_findings(findings)]
    text = "\n".join(inspection_lines(figures))
    parts += [f'<pre style="white-space:pre-wrap">{escape(text)}</pre>', "<h2>Pictures</h2>"]
    parts += [figure(picture, caption) for picture, caption in pictures]
    parts.append("<details><summary>All figures</summary>")
    for name, group in figures.items():
        parts += [f"<h2>{escape(_words(name).capitalize())}</h2>"]
        if name in _MEANINGS:
            parts.append(f"<p>{escape(_MEANINGS[name])}</p>")
        parts.append(_group(group))
    parts += [f"<p>docdepth {escape(__version__)}</p>", "</details>"]
    write_page(path, parts)


def _as_text(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{_words(key)} {_as_text(item)}" for key, item in value.items())
    if isinstance(value, list):
        if value and isinstance(value[0], list):
            return ", ".join(" to ".join(map(_as_text, item)) for item in value)
        return ", ".join(map(_as_text, value)) or "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.3f}" if abs(value) > 1e6 else f"{value:.4g}"
    return "unknown" if value is None else str(value)


def _words(name: str) -> str:
    """A name of figures, with its unit in brackets."""
    for suffix, unit in _UNITS.items():
        if name.endswith(suffix):
            return f"{name.removesuffix(suffix).replace('_', ' ')} [{unit}]"
    return name.replace("_", " ")


def _findings(findings: Sequence[tuple[str, str]]) -> Iterator[str]:
    if not any(severity != "note" for severity, _ in findings):
        yield "<p>No problem was found.</p>"
    for severity, text in findings:
        color = _COLORS[severity]
        yield f'<p><b style="color:{color}">{severity}</b> {escape(text)}</p>'


def _group(group: Any) -> str:
    if isinstance(group, list) and group:
        names = list(dict.fromkeys(key for entry in group for key in entry))
        rows = [tuple(_as_text(entry.get(name)) for name in names) for entry in group]
        return table(tuple(_words(name) for name in names), rows)
    if isinstance(group, dict):
        return table((), ((_words(key), _as_text(value)) for key, value in group.items()))
    return f"<p>{'none' if not group else escape(_as_text(group))}</p>"
