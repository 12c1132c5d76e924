"""Pages of docdepth: tables, pictures, legends and images to flip between, in one HTML file."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.errors import DatasetError
from docdepth.io.atomic import move_aside, write_atomically
from docdepth.io.images import encode_image
from docdepth.io.untrusted import read_file
from docdepth.visualization.pictures import FAR, NEAR, Picture, colorize

_MARK = "<!-- docdepth page -->"

STYLE = """
:root { color-scheme: light dark; --ink: #1a1a1a; --paper: #fff; --soft: #595959; --line: #ccc;
  --fill: #f0f0f0; --accent: #003c96; --alert: #fff4ec }
@media (prefers-color-scheme: dark) { :root { --ink: #e4e4e4; --paper: #17191c; --soft: #a8a8a8;
  --line: #4a4d52; --fill: #2b2e33; --accent: #8ab4ff; --alert: #3a2a1e } }
body { font: 15px/1.5 system-ui, sans-serif; margin: 1.5em auto; max-width: 1300px; padding: 0 1em;
  color: var(--ink); background: var(--paper); overflow-wrap: break-word }
h1 { font-size: 24px; margin: 0 } h2 { font-size: 18px; margin: 2em 0 .5em }
table { border-collapse: collapse; margin: .5em 0; display: block; overflow-x: auto }
td, th { padding: .2em 1.2em .2em 0; text-align: left; vertical-align: top }
th { font-weight: 600; border-bottom: 1px solid var(--line) }
figure { margin: 0 0 1em } img, video { max-width: 100% }
figcaption, .note { color: var(--soft); font-size: 13px }
.legend { display: flex; flex-wrap: wrap; gap: .2em 1.4em; font-size: 13px; margin: .4em 0 }
.legend i { display: inline-block; width: 1em; height: 1em; vertical-align: -2px;
  border: 1px solid #888 } .legend i:last-of-type { margin-right: .4em }
.scale { width: min(100%, 460px); font-size: 13px } .scale i { display: block; height: 12px }
.scale div { position: relative; height: 1.5em } .scale span { position: absolute;
  white-space: nowrap; transform: translateX(-50%) } .scale span:first-child { transform: none }
.scale span:last-child { transform: translateX(-100%) }
@media (max-width: 500px) { .scale span:nth-child(2) { display: none } }
"""

FLIP_STYLE = """
.row { display: flex; flex-wrap: wrap; gap: .6em; align-items: center; margin: .4em 0 }
.row input { flex: 1; min-width: 60px; accent-color: var(--accent) }
button { font: inherit; padding: .15em .8em; border: 1px solid #888; border-radius: 4px;
  color: inherit; background: var(--fill); cursor: pointer }
button[aria-pressed=true] { background: var(--accent); color: var(--paper) }
.views { display: grid; position: relative; overflow: hidden; min-height: 60px; color: #fff;
  background: #181818; cursor: zoom-in; touch-action: pan-y }
.views img { grid-area: 1 / 1; display: block; width: 100%; max-height: 78vh;
  object-fit: contain }
.views.large { cursor: zoom-out; touch-action: none }
.views.large img { transform: scale(4); image-rendering: pixelated }
.views output { position: absolute; top: .4em; left: .4em; padding: .1em .6em; border-radius: 4px;
  background: #000b; pointer-events: none; font-variant-numeric: tabular-nums }
[hidden], .views img[hidden] { display: none }
"""
"""Of a page with a :func:`image_flipper`."""

_DEPTH_TICKS = (3, 5, 10, 20, 40, 80)  # metres
_QUALITIES = (90, 80, 65, 45, 25, 10)
# Thin coloured lines and points smear where colours are sampled more coarsely than brightness.
_SAMPLING = (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)


def head(title: str, style: str = "") -> str:
    """Beginning of a page, with its title as heading."""
    return (
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{escape(title)}</title>\n"
        '<meta name=viewport content="width=device-width, initial-scale=1">\n'
        f"{_MARK}<style>{STYLE}{style}</style><h1>{escape(title)}</h1>"
    )


def check_page(path: Path) -> None:
    """Refuse a file that is no page of docdepth."""
    if path.exists() and not path.is_file():
        what = "a folder" if path.is_dir() else "no regular file"
        raise DatasetError(f"{path} is {what}; name a file for the page")
    if path.is_file() and _MARK.encode() not in read_file(path)[:6000]:
        raise DatasetError(f"{path} is no page of docdepth; name another file")


def write_page(path: Path, parts: Iterable[str]) -> None:
    """Write a page of :func:`head` and other parts, in one file that needs nothing else.

    A page that was changed since docdepth wrote it becomes ``NAME.old``.
    """
    check_page(path)
    path = path.resolve()  # a link stays one
    content = "\n".join(parts).encode(errors="replace")
    content += _seal(content)
    try:
        known = read_file(path) if path.is_file() else content
        if not known.endswith(_seal(known[: -len(_seal(known))])):
            move_aside(path)
        write_atomically(path, content)
    except OSError as error:
        raise DatasetError(
            f"{path} cannot be written ({error.strerror}); name another file"
        ) from None


def _seal(content: bytes) -> bytes:
    """The end of a page, which tells whether it was changed."""
    return f"\n<!-- {zlib.crc32(content):08x} -->\n".encode()


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
            content = encode_image(picture, ".jpg", cv2.IMWRITE_JPEG_QUALITY, quality, *_SAMPLING)
            if most is None or len(content) <= most or max(picture.shape[:2]) < 2:
                return "data:image/jpeg;base64," + base64.b64encode(content).decode()
        half = (max(picture.shape[1] // 2, 1), max(picture.shape[0] // 2, 1))
        picture = np.asarray(cv2.resize(picture, half, interpolation=cv2.INTER_AREA), np.uint8)


def embedded_depth(depth: NDArray[np.float32], most: int) -> str:
    """A link that holds a depth map of at most so many pixels, for the value under the pointer.

    It is a PNG whose red and green are the high and the low byte of the depth in centimetres; 0
    where there is none.
    """
    step = int(np.ceil((depth.size / most) ** 0.5))
    cm = np.nan_to_num(depth[::step, ::step] * 100).round().clip(0, 65535).astype(np.uint16)
    low = (cm & 255).astype(np.uint8)
    bgr = np.stack([np.zeros_like(low), low, (cm >> 8).astype(np.uint8)], axis=2)
    return "data:image/png;base64," + base64.b64encode(encode_image(bgr, ".png")).decode()


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


def depth_scale() -> str:
    """The legend of the colours of depth; what is nearer or farther has those of the ends."""
    ends, span = {NEAR: "\u2264 ", FAR: "\u2265 "}, np.log(FAR / NEAR)
    colors = colorize(np.geomspace(NEAR, FAR, 24)[None], bar=False)[0]
    return scale(
        colors, ((np.log(t / NEAR) / span, f"{ends.get(t, '')}{t} m") for t in _DEPTH_TICKS)
    )


class PageImage(NamedTuple):
    """An image of a page, seen in several ways."""

    caption: str
    # links that hold the pictures, by view. The view ``image`` is the photo, which others can be
    # wiped away from
    views: dict[str, str]
    seconds: float = 0.0  # when it was taken, for what else the page shows of that time
    values: str = ""  # link that holds the depth, of :func:`embedded_depth`; empty without
    file: str = ""  # a picture beside the page, for an image whose pictures the page does not hold


_WIPE = (
    "<div class='row note'>photo<input class=wipe type=range min=0 max=100 value=0 "
    "aria-label='share of the photo'></div>"
)


def image_flipper(
    images: Sequence[PageImage], titles: Mapping[str, str], legends: Mapping[str, str], note: str
) -> str:
    """Pictures with buttons for the views, a slider for the images, and one for the photo.

    Parameters
    ----------
    images : sequence of PageImage
        At least one; the first one has views.
    titles : mapping of str to str
        What the button of each view says; views that no image has are left out.
    legends : mapping of str to str
        HTML below the pictures of a view.
    note : str
        What follows the caption.
    """
    views = [view for view in titles if any(view in image.views for image in images)]
    first = views[0]
    pictures = [
        f'<img src="{image.views[view]}" data-image={k} data-view={view} '
        f'alt="{escape(titles[view])}"{"" if k == 0 and view == first else " hidden"}>'
        for k, image in enumerate(images)
        for view in views
        if view in image.views
    ]
    pictures += [
        f'<img src="{image.values}" data-values={k} alt="" hidden>'
        for k, image in enumerate(images)
        if image.values
    ]
    names = [
        f'<span class=name data-of={k} data-seconds={image.seconds:.3f} data-file="'
        f'{escape(image.file)}"{" hidden" if k else ""}>{escape(image.caption)}</span>'
        for k, image in enumerate(images)
    ]
    buttons = [f"<button data-choose={view}>{escape(titles[view])}</button>" for view in views]
    shown = [
        f"<div data-of={view}{'' if view == first else ' hidden'}>{legends.get(view, '')}</div>"
        for view in views
    ]
    how = "keys: arrows and 1, 2, 3 ...; a click magnifies"
    return "\n".join([
        f"<div class=flip><div class=row>{''.join(buttons)}</div>",
        f"<div class=views>{''.join(pictures)}<output hidden></output></div>{''.join(shown)}",
        _WIPE if "image" in views[1:] else "",
        "<div class=row><button class=before aria-label='image before'>&larr;</button>",
        f"<input class=image type=range min=0 max={len(images) - 1} value=0 aria-label=image>",
        "<button class=after aria-label='next image'>&rarr;</button></div>",
        f"<p>{''.join(names)} <span class=note>({escape(f'{note}; {how}')})</span></p></div>",
    ])  # fmt: skip


def scripts(names: Iterable[str] = ()) -> str:
    """What the page needs at its end: flipping, and further scripts of this folder."""
    folder = Path(__file__).parent
    texts = [(folder / name).read_text(encoding="utf-8") for name in ("flip.js", *names)]
    return "".join(f"<script>{text}</script>" for text in texts)
