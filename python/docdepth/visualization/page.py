"""Pages of docdepth: tables and pictures in HTML that needs nothing else."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from html import escape

import cv2

from docdepth.visualization.pictures import Picture

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2em auto; max-width: 1300px; padding: 0 1em }
table { border-collapse: collapse; margin: 1em 0 }
td, th { padding: .2em 1em .2em 0; text-align: left; vertical-align: top }
figure { margin: 0 0 1em } img, video { max-width: 100% }
figcaption { color: #666; font-size: 13px }
"""


def head(title: str) -> str:
    """Beginning of a page, with its title as heading."""
    return (
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{escape(title)}</title>\n"
        f"<style>{STYLE}</style><h1>{escape(title)}</h1>"
    )


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
    encoded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 88])[1].tobytes()
    data = base64.b64encode(encoded).decode()
    return (
        f'<figure><img src="data:image/jpeg;base64,{data}" alt=""><figcaption>{escape(caption)}'
        "</figcaption></figure>"
    )
