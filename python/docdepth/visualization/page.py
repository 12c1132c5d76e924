"""Pages of docdepth: tables, pictures and legends in HTML that needs nothing else."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

import cv2
import numpy as np

from docdepth.errors import DatasetError
from docdepth.io.atomic import write_atomically
from docdepth.visualization.pictures import Picture

_MARKS = "<!-- docdepth page -->", "<!-- docdepth inspect -->"  # today's, and that of earlier pages

STYLE = """
:root { color-scheme: light }
body { font: 15px/1.5 system-ui, sans-serif; margin: 1.5em auto; max-width: 1300px; padding: 0 1em;
  color: #1a1a1a; background: #fff }
h1 { font-size: 24px; margin: 0 } h2 { font-size: 18px; margin: 2em 0 .5em }
table { border-collapse: collapse; margin: .5em 0; display: block; overflow-x: auto }
td, th { padding: .2em 1.2em .2em 0; text-align: left; vertical-align: top }
th { font-weight: 600; border-bottom: 1px solid #ccc }
figure { margin: 0 0 1em } img, video { max-width: 100% }
figcaption, .note { color: #595959; font-size: 13px }
.legend { display: flex; flex-wrap: wrap; gap: .2em 1.4em; font-size: 13px; margin: .4em 0 }
.legend i { display: inline-block; width: 1em; height: 1em; vertical-align: -2px;
  border: 1px solid #888 } .legend i:last-of-type { margin-right: .4em }
.scale { width: min(100%, 460px); font-size: 13px } .scale i { display: block; height: 12px }
.scale div { position: relative; height: 1.5em } .scale span { position: absolute;
  white-space: nowrap; transform: translateX(-50%) } .scale span:first-child { transform: none }
.scale span:last-child { transform: translateX(-100%) }
"""

_QUALITIES = (90, 80, 65, 45, 25, 10)


def head(title: str, style: str = "") -> str:
    """Beginning of a page, with its title as heading."""
    return (
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{escape(title)}</title>\n"
        '<meta name=viewport content="width=device-width, initial-scale=1">\n'
        f"{_MARKS[0]}<style>{STYLE}{style}</style><h1>{escape(title)}</h1>"
    )


def check_page(path: Path) -> None:
    """Refuse a file that is no page of docdepth.

    Raises
    ------
    DatasetError
    """
    if path.is_dir():
        raise DatasetError(f"{path} is a folder; name a file for the page")
    if path.is_file():
        start = path.read_bytes()[:6000]
        if not any(mark.encode() in start for mark in _MARKS):
            raise DatasetError(f"{path} is no page of docdepth; name another file")


def write_page(path: Path, parts: Iterable[str]) -> None:
    """Write a page of :func:`head` and other parts, in one file that needs nothing else.

    Raises
    ------
    DatasetError
        There is a file that is no page of docdepth, or none can be written.
    """
    check_page(path)
    content = "\n".join(parts).encode(errors="replace")
    try:
        write_atomically(path, lambda stream: stream.write(content))
    except OSError as error:
        raise DatasetError(
            f"{path} cannot be written ({error.strerror}); name another file"
        ) from None


def table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    """A table of texts; without ``head`` it has no heading."""
    lines = (
        ["<tr>" + "".join(f"<th>{escape(cell)}</th>" for cell in head) + "</tr>"] if head else []
    )
    for row in rows:
        lines.append("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>")
    return "<table>" + "\n".join(lines) + "</table>"


def figure(picture: Picture, caption: str) -> str:
    """A picture (BGR) within the page, as JPEG."""
    return (
        f'<figure><img src="{embedded(picture)}" alt=""><figcaption>{escape(caption)}'
        "</figcaption></figure>"
    )


def embedded(picture: Picture, most: int | None = None) -> str:
    """A link that holds a picture (BGR), as JPEG.

    Parameters
    ----------
    picture : ndarray of uint8, shape (h, w, 3)
    most : int, optional
        Bytes of the JPEG; it gets coarser, and then smaller, until it fits.
    """
    while True:
        for quality in _QUALITIES:
            content = _jpeg(picture, quality)
            if most is None or len(content) <= most or max(picture.shape[:2]) < 2:
                return "data:image/jpeg;base64," + base64.b64encode(content).decode()
        half = (max(picture.shape[1] // 2, 1), max(picture.shape[0] // 2, 1))
        picture = np.asarray(cv2.resize(picture, half, interpolation=cv2.INTER_AREA), np.uint8)


def _jpeg(picture: Picture, quality: int) -> bytes:
    # Thin coloured lines and points smear where colours are sampled more coarsely than brightness.
    sampling = [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    encoded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality, *sampling])[1]
    return encoded.tobytes()


def css(color: Sequence[int]) -> str:
    """A colour of a picture (BGR) for a page."""
    blue, green, red = (int(value) for value in color)
    return f"#{red:02x}{green:02x}{blue:02x}"


def swatches(meanings: Iterable[tuple[Sequence[Sequence[int]], str]]) -> str:
    """A legend: one or several colours (BGR), and what they mean."""
    items = (
        "<span>"
        + "".join(f'<i style="background:{css(color)}"></i>' for color in colors)
        + f"{escape(text)}</span>"
        for colors, text in meanings
    )
    return f"<div class=legend>{''.join(items)}</div>"


def scale(colors: Picture, ticks: Iterable[tuple[float, str]]) -> str:
    """A legend of even steps of colour from left to right.

    Parameters
    ----------
    colors : ndarray of uint8, shape (n, 3)
        BGR, from the left to the right end.
    ticks : iterable of (float, str)
        Place from 0 to 1, and what stands there; from left to right.
    """
    stops = ",".join(css(color) for color in colors)
    marks = "".join(f'<span style="left:{100 * x:.1f}%">{escape(t)}</span>' for x, t in ticks)
    return (
        f'<div class=scale><i style="background:linear-gradient(90deg,{stops})"></i>'
        f"<div>{marks}</div></div>"
    )
