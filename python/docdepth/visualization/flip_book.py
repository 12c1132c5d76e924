"""Images of a page to flip between, each with several views and the legend of the view."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import NamedTuple

STYLE = """
.row { display: flex; flex-wrap: wrap; gap: .6em; align-items: center; margin: .4em 0 }
.row input { flex: 1; min-width: 60px }
button { font: inherit; padding: .15em .8em; border: 1px solid #888; border-radius: 4px;
  background: #f2f2f2; cursor: pointer }
button[aria-pressed=true] { background: #003c96; color: #fff }
.views { background: #181818; min-height: 60px } .views img { display: block; width: 100%;
  max-height: 78vh; object-fit: contain }
[hidden], .views img[hidden] { display: none }
"""


class Leaf(NamedTuple):
    """An image of a book.

    Attributes
    ----------
    caption : str
    views : dict of str to str
        Links that hold the pictures, by view.
    seconds : float
        When it was taken, for what else the page shows of that time.
    """

    caption: str
    views: dict[str, str]
    seconds: float = 0.0


def flip_book(
    leaves: Sequence[Leaf], titles: Mapping[str, str], legends: Mapping[str, str], note: str = ""
) -> str:
    """Pictures with buttons for the views and a slider for the images.

    Parameters
    ----------
    leaves : sequence of Leaf
        At least one.
    titles : mapping of str to str
        What the button of each view says; views that no image has are left out.
    legends : mapping of str to str
        HTML below the pictures of a view.
    note : str
        What follows the caption.
    """
    views = [view for view in titles if any(view in leaf.views for leaf in leaves)]
    first = views[0]
    pictures = [
        f'<img src="{leaf.views[view]}" data-image={k} data-view={view} '
        f'alt="{escape(titles[view])}"{"" if k == 0 and view == first else " hidden"}>'
        for k, leaf in enumerate(leaves)
        for view in views
        if view in leaf.views
    ]
    names = [
        f"<span class=name data-of={k} data-seconds={leaf.seconds:.3f}{' hidden' if k else ''}>"
        f"{escape(leaf.caption)}</span>"
        for k, leaf in enumerate(leaves)
    ]
    buttons = [f"<button data-choose={view}>{escape(titles[view])}</button>" for view in views]
    shown = [
        f"<div data-of={view}{'' if view == first else ' hidden'}>{legends.get(view, '')}</div>"
        for view in views
    ]
    return "\n".join([
        f"<div class=flip><div class=row>{''.join(buttons)}</div>",
        f"<div class=views>{''.join(pictures)}</div>{''.join(shown)}",
        "<div class=row><button class=before aria-label='image before'>&larr;</button>",
        f"<input type=range min=0 max={len(leaves) - 1} value=0 aria-label=image>",
        "<button class=after aria-label='next image'>&rarr;</button></div>",
        f"<p>{''.join(names)} <span class=note>{escape(note)}</span></p></div>",
    ])  # fmt: skip


def scripts(names: Iterable[str] = ()) -> str:
    """What the page needs at its end: flipping, and further scripts of this folder."""
    folder = Path(__file__).parent
    texts = [(folder / name).read_text(encoding="utf-8") for name in ("flip.js", *names)]
    return "".join(f"<script>{text}</script>" for text in texts)
