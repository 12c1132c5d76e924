"""What a recording holds and what is wrong with it: lines for a terminal, and a page."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime, timezone
from html import escape
from pathlib import Path
from typing import Any

from docdepth._core import __version__
from docdepth.visualization.page import figure, head, table, write_page
from docdepth.visualization.pictures import Picture

Figures = dict[str, Any]
"""Figures by name, ready for JSON, in groups that recordings differ in."""

_COLORS = {"error": "#d32f4a", "warning": "#b86a00", "note": "#777"}
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
_MARGIN = 10  # columns that the names of groups take


def write_inspection(
    path: Path,
    figures: Figures,
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


def inspection_lines(figures: Figures) -> Iterator[str]:
    """Lines that tell the figures of a recording."""
    recording = figures["recording"]
    yield f"{recording['path']}, read as {recording['format']}"
    yield from _entry("sweeps", _sweeps(figures["sweeps"], figures.get("point_times")))
    for lidar in figures.get("lidars", []):
        yield from _entry("LiDAR", _lidar(lidar))
    if figures.get("rows"):
        yield from _entry("rows", _rows(figures["rows"]))
    if "ground" in figures:
        yield from _entry("ground", _ground(figures["ground"]))
    yield from _entry("poses", _poses(figures.get("poses"), figures.get("registered", [])))
    if figures.get("ego"):
        yield from _entry("vehicle", _ego(figures["ego"]))
    for camera in figures.get("cameras", []):
        yield from _entry("camera", _camera(camera))


def _entry(name: str, lines: Iterator[str]) -> Iterator[str]:
    for k, line in enumerate(lines):
        yield f"  {'' if k else name:{_MARGIN}}{line}"


def _sweeps(sweeps: Figures, times: Figures | None) -> Iterator[str]:
    yield _stamps(sweeps)
    if "motion_compensated" not in sweeps:
        return
    if times is not None:
        first, last = times["span_s"] or times["span"]
        unit, scale = ("sweeps", 1) if times["span_s"] is None else ("ms", 1000)
        yield f"points are measured {_span(scale * first, scale * last)} {unit} after the stamp"
    if sweeps["motion_compensated"]:
        yield "motion compensated already"
    elif times is None:
        yield "points have no times"
    else:
        yield "not motion compensated yet: a run does it"


def _stamps(stamps: Figures) -> str:
    """Count, rate, gaps and span of stamps."""
    count, first, last = (stamps[key] for key in ("count", "from_s", "to_s"))
    if count < 2:
        return f"{count}" if first is None else f"{count}, at {_date(first)}"
    gaps = _span(*(1e3 * stamps[key] for key in ("shortest_gap_s", "longest_gap_s")))
    rate = f"{stamps['rate_hz'] or 0:g} a second, {gaps} ms apart"
    return f"{count} in {last - first:.1f} s from {_date(first)}: {rate}"


def _span(least: float, most: float) -> str:
    """Two numbers of four digits, or one where they are equal."""
    return " to ".join(dict.fromkeys(f"{round(value, 1) + 0.0:.4g}" for value in (least, most)))


def _date(seconds: float) -> str:
    """Times since a sensor began to count are no dates."""
    if seconds < 1e8:
        return f"{seconds:.3f} s"
    return f"{datetime.fromtimestamp(seconds, timezone.utc):%Y-%m-%d %H:%M:%S} UTC"


def _lidar(lidar: Figures) -> Iterator[str]:
    least, median, far, most = lidar["range_m"]
    low, high = lidar["field_of_view_deg"]["vertical"]
    yield (
        f"{lidar['name']}: {lidar['points']} points from {least:.1f} to {most:.0f} m, half of them "
        f"within {median:.1f} m, 99 % within {far:.0f} m"
    )
    beams = f"{lidar['beams']} beams" if lidar["beams"] else "no beams that can be told apart"
    around = lidar["field_of_view_deg"]["horizontal"]
    yield f"{beams}; sees {around} degrees around, from {low:g} to {high:g} degrees of elevation"
    if lidar["spacing_deg"]:
        along, across = lidar["spacing_deg"]
        yield f"neighbouring points {along:g} degrees apart along a beam, {across:g} across"
    if lidar["same_ray"]:
        yield (
            f"{_percent(lidar['same_ray'])} of the points share their ray with another one, "
            f"{_percent(lidar['same_point'])} their place"
        )


def _rows(rows: Figures) -> Iterator[str]:
    names = {
        "not_finite": "are not finite",
        "at_origin": "are at the origin",
        "close": "are nearer than half a metre",
        "one_place": "are in one other place",
    }
    told = [f"{_percent(rows[key])} {words}" for key, words in names.items() if rows[key]]
    yield "at most, of a sweep: " + ", ".join(told) if told else "all are returns"


def _ground(ground: Figures | None) -> Iterator[str]:
    if ground is None:
        yield "not found"
        return
    tilt, height = ground["tilt_deg"], ground["height_m"]
    yield f"{height:g} m below the origin; z is {tilt:g} degrees from its normal"


def _poses(poses: Figures | None, registered: list[Figures]) -> Iterator[str]:
    if poses is None:
        yield "none: a run estimates them"
    else:
        median, most = poses["speed_m_s"]
        yield (
            f"of the {poses['source']}: a path of {poses['length_m']:g} m, {median:g} m/s in the "
            f"median and {most:g} at most, at most {poses['largest_turn_deg']:g} degrees a sweep"
        )
    for window in registered:
        first, last = window["frames"]
        yield (f"sweeps {first} to {last} show a motion of {window['metres_a_sweep']:g} m a sweep")


def _ego(ego: Figures) -> Iterator[str]:
    mirrored = ", and its mirror image below the ground" if ego["mirrored"] else ""
    yield f"{ego['returns']} returns a sweep stay with the LiDAR while it moves{mirrored}"


def _camera(camera: Figures) -> Iterator[str]:
    size, field = camera.get("size"), camera.get("field_of_view_deg")
    kind = f"{size[0]} x {size[1]} pixels, {field:g} degrees wide" if size else "of unknown size"
    yield f"{camera['name']}: {kind}{'' if camera['calibrated'] else ', not calibrated'}"
    images = "" if camera["images"] else ", without images"
    yield f"{_stamps(camera)}{images}"
    if camera["count"]:
        yield (
            f"{camera['within_sweeps']} between the first and the last sweep, "
            f"{1e3 * camera['from_nearest_sweep_s']:.3g} ms from the nearest in the median"
        )


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"
