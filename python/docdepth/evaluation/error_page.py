"""Pages of errors, the worst images first: what ``docdepth evaluate ... --html`` writes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream
from docdepth.evaluation.depth_metrics import RELATIVE_ERROR
from docdepth.evaluation.held_out import HeldOutView
from docdepth.evaluation.label_counts import ignored, moving
from docdepth.evaluation.tables import Table
from docdepth.geometry.points import DYNAMIC, STATIC
from docdepth.visualization.image_views import photo_of
from docdepth.visualization.page import (
    FLIP_STYLE,
    PageImage,
    depth_scale,
    embedded,
    head,
    image_flipper,
    scale,
    scripts,
    swatches,
    table,
    write_page,
)
from docdepth.visualization.pictures import (
    BACKGROUND,
    ERROR_LIMIT,
    FALSE_COLOR,
    FOUND_COLOR,
    GROUND_COLOR,
    MISSED_COLOR,
    STATIC_COLOR,
    Picture,
    colorize,
    error_picture,
    labels_from_above,
    labels_in_range_image,
    spread_depth,
)

Depth = NDArray[np.float32]

WORST = 12
"""Images on a page."""

_NO_DEPTH = (110, 110, 110)
_BYTES = 160_000  # of a picture
_SOON = 100_000_000  # nanoseconds between a sweep and its photo
_REACH, _SIDE = 50.0, 1000  # of the view from above: metres to each side, pixels

_STYLE = """
.bars { display: flex; align-items: flex-end; height: 80px; gap: 1px;
  border: 1px solid var(--line) }
.bars i { flex: 1; background: #d55e00; min-width: 1px }
"""


@dataclass
class ErrorPage:
    """Gathers the worst images of an evaluation and writes the page."""

    title: str
    what: str  # one sentence on what is compared with what
    # titles, legends: what the button of each view says, and what stands below it, HTML
    titles: dict[str, str]
    legends: dict[str, str]
    bars: str  # what the bars over all images show
    images: str = "images"  # what the images are of
    _scores: list[tuple[str, float]] = field(default_factory=list)
    _worst: list[tuple[float, int, PageImage]] = field(default_factory=list)

    def add(
        self, name: str, score: float, caption: str, pictures: Callable[[], dict[str, Picture]]
    ) -> None:
        """Add an image; its pictures are made if it is among the worst so far."""
        number = len(self._scores)
        self._scores.append((name, score))
        if len(self._worst) == WORST and score <= self._worst[-1][0]:
            return
        views = {view: embedded(picture, _BYTES) for view, picture in pictures().items()}
        self._worst.append((score, -number, PageImage(caption, views)))
        self._worst = sorted(self._worst, key=lambda entry: entry[:2], reverse=True)[:WORST]

    def write(self, path: Path, tables: Iterable[Table], found: Iterable[str] = ()) -> None:
        """Write the page."""
        images = [image for _, _, image in self._worst]
        parts = [head(self.title, FLIP_STYLE + _STYLE), f"<p>{escape(self.what)}</p>"]
        parts += [f"<p><b>warning:</b> {escape(line)}</p>" for line in found]
        if images:
            of = f"worst first, {len(images)} of {len(self._scores)}"
            pictures = image_flipper(images, self.titles, self.legends, of)
            parts += [f"<h2>The worst {self.images}</h2>", pictures]
            parts += [f"<h2>All {self.images}</h2>", self._chart()]
        parts.append("<h2>Figures</h2>")
        for one in tables:
            parts += [f"<h3>{escape(one.title)}</h3>", table(one.header, one.rows)]
            items = "".join(f"<li>{escape(item)}</li>" for item in one.note.split("; ") if item)
            parts.append(f"<ul class=note>{items}</ul>")
        write_page(path, [*parts, scripts()])

    def _chart(self) -> str:
        """A bar for each image, in order; of many images the worst of each group."""
        values = np.array([score for _, score in self._scores])
        groups = np.array_split(np.arange(len(values)), min(len(values), 400))
        most = float(values.max()) or 1.0
        bars = "".join(
            f'<i style="height:{100 * values[group].max() / most:.1f}%" '
            f'title="{escape(self._scores[int(group[values[group].argmax()])][0])}: '
            f'{values[group].max():.3g}"></i>'
            for group in groups
        )
        first, last = self._scores[0][0], self._scores[-1][0]
        return (
            f"<p>{escape(self.bars)}: {values.mean():.3g} on average, {values.max():.3g} in the "
            f"worst. From {escape(first)} to {escape(last)}:</p><div class=bars>{bars}</div>"
        )


class DepthPage(ErrorPage):
    """A page of depth maps against true ones.

    Parameters
    ----------
    max_range : float
        Pixels with a larger true depth are not compared [m].
    stream : CameraStream, optional
        The camera, whose photos are shown beside.
    """

    def __init__(self, title: str, max_range: float, stream: CameraStream | None) -> None:
        what = (
            "Depth maps against true depth: each pixel up to "
            f"{max_range:g} m that has both is compared."
        )
        titles = {"error": "errors", "depth": "depth map", "truth": "true depth", "image": "image"}
        super().__init__(title, what, titles, _depth_legends(), _SHARE_WRONG)
        self._max_range, self._stream = max_range, stream

    def look(self, name: str, depth: Depth, truth: Depth) -> None:
        """Add an image: its name, the made depth and the true one, (h, w) [m]."""
        near = np.where(truth <= self._max_range, truth, np.float32(np.nan))
        score, caption = _wrong(depth, near)

        def pictures() -> dict[str, Picture]:
            return {
                "error": _errors(depth, near),
                "depth": colorize(depth, bar=False),
                "truth": colorize(_thick(truth), bar=False),
                **_photo(self._stream, name),
            }

        self.add(name, score, f"image {name}: {caption}", pictures)


class HeldOutPage(ErrorPage):
    """A page of depth maps against returns left out of them.

    Parameters
    ----------
    max_range : float
        Returns that are farther are not shown [m].
    left_out : str
        What was left out, in words.
    stream : CameraStream, optional
        The camera, whose photo nearest in time is shown beside, for orientation.
    times : ndarray of int64, shape (n,)
        Of the sweeps [ns].
    """

    def __init__(
        self,
        title: str,
        max_range: float,
        left_out: str,
        stream: CameraStream | None,
        times: NDArray[np.int64],
    ) -> None:
        what = (
            f"Depth maps against {left_out}: each map is drawn without them, as the LiDAR would "
            f"see it. Each return up to {max_range:g} m is compared with its pixel."
        )
        titles = {"error": "errors at the returns", "depth": "depth map", "truth": "returns"}
        titles["image"] = "photo of that time"
        legends = {**_depth_legends(), "image": _BESIDE}
        legends["error"] += _CLEAR
        super().__init__(title, what, titles, legends, _SHARE_WRONG, "views")
        self._max_range, self._stream, self._times = max_range, stream, times

    def look(self, view: HeldOutView) -> None:
        """Add a view."""
        truth = np.where(view.truth <= self._max_range, view.truth, np.float32(np.nan))
        score, caption = _wrong(view.depth, truth)

        def pictures() -> dict[str, Picture]:
            thick, depth = _thick(truth), colorize(view.depth, bar=False)
            errors, known = _errors(_at(truth, view.depth), thick), ~np.isnan(thick)
            views = {
                "error": np.where(known[..., None], errors, depth // 4).astype(np.uint8),
                "depth": depth,
                "truth": colorize(thick, bar=False),
            }
            stream = self._stream
            if stream is not None and len(stream.times):
                apart = np.abs(stream.times - self._times[view.index])
                nearest = int(apart.argmin())
                if apart[nearest] < _SOON:
                    views |= _photo(stream, stream.names[nearest])
            return views

        self.add(view.name, score, f"sweep {view.name}: {caption}", pictures)


class LabelPage(ErrorPage):
    """A page of labels against true ones."""

    def __init__(self, title: str) -> None:
        what = (
            "Labels of points against true labels: which points belong to something that moves. "
            "Points without a true label count as static here."
        )
        legend = swatches([
            ([FOUND_COLOR], "moves, and found"),
            ([MISSED_COLOR], "moves, but missed"),
            ([FALSE_COLOR], "false alarm: labelled as moving, but stands"),
            ([STATIC_COLOR], "static"),
            ([GROUND_COLOR], "ground"),
        ])  # fmt: skip
        titles = {"above": "from above", "range": "as the LiDAR sees it"}
        above = (
            "<p class=note>50 m to each side; the vehicle is in the middle and drives up. Wrong "
            "points are drawn larger.</p>"
        )
        around = "<p class=note>From left to right: behind, left, ahead, right, behind.</p>"
        legends = {"above": legend + above, "range": legend + around}
        super().__init__(title, what, titles, legends, "Wrong points of each sweep", "sweeps")

    def look(
        self,
        name: str,
        points: NDArray[np.float32],
        classid: NDArray[np.uint16],
        labels: NDArray[np.uint32],
    ) -> None:
        """Add a sweep: name, points (N, 3) [m], their classes and true SemanticKITTI labels."""
        classid = np.where(ignored(labels), np.minimum(classid, STATIC), classid).astype(np.uint16)
        truth, dynamic = moving(labels), classid >= DYNAMIC
        missed, false = int((truth & ~dynamic).sum()), int((dynamic & ~truth).sum())
        caption = (
            f"sweep {name}: {missed} of {int(truth.sum())} moving points missed, "
            f"{false} false alarms"
        )

        def pictures() -> dict[str, Picture]:
            return {
                "above": _from_above(points, classid, truth),
                "range": labels_in_range_image(points, classid, truth),
            }

        self.add(name, float(missed + false), caption, pictures)


def _from_above(
    points: NDArray[np.float32], classid: NDArray[np.uint16], truth: NDArray[np.bool_]
) -> Picture:
    """Labels from above, wrong points larger, and the vehicle."""
    picture = labels_from_above(points, classid, truth, _REACH, _SIDE)
    dynamic, middle = classid >= DYNAMIC, _SIDE // 2
    for chosen, color in ((dynamic & ~truth, FALSE_COLOR), (truth & ~dynamic, MISSED_COLOR)):
        places = (_REACH - points[chosen, :2]) * (_SIDE / (2 * _REACH))
        for row, column in np.rint(places).astype(int).tolist():
            cv2.circle(picture, (column, row), 4, color, -1)
    corners = [(middle, middle - 14), (middle - 8, middle + 14), (middle + 8, middle + 14)]
    cv2.polylines(picture, [np.array(corners, np.int32)], True, (255, 255, 255), 2, cv2.LINE_AA)
    return picture


_BESIDE = "<p class=note>The camera stands beside the LiDAR, so the photo is a little shifted.</p>"
_SHARE_WRONG = "Share of the compared pixels that are more than 5 % off, in percent"
_CLEAR = (
    "<p class=note>A return beside a depth edge may fall into a pixel of the other side; the row "
    "<i>clear</i> of the table is without these.</p>"
)


def _depth_legends() -> dict[str, str]:
    shares = np.linspace(-ERROR_LIMIT, ERROR_LIMIT, 21)[None] + 1
    colors = error_picture(shares, np.ones_like(shares))[0]
    ticks = [(0.0, "10 % too near"), (0.5, "right"), (1.0, "10 % too far")]
    empty = swatches(
        [([_NO_DEPTH], "no depth was made"), ([(BACKGROUND,) * 3], "nothing to compare")]
    )
    depth = depth_scale()
    return {"error": scale(colors, ticks) + empty, "depth": depth, "truth": depth}


def _errors(depth: Depth, truth: Depth) -> Picture:
    picture = error_picture(depth, truth)
    picture[np.isnan(depth) & ~np.isnan(truth)] = _NO_DEPTH
    return picture


def _wrong(depth: Depth, truth: Depth) -> tuple[float, str]:
    """Share of the compared pixels more than 5 % off [%], and that in words."""
    both = ~np.isnan(depth) & ~np.isnan(truth)
    error = depth[both].astype(np.float64) - truth[both]
    off = np.abs(error) > RELATIVE_ERROR * truth[both]
    share = 100 * float(off.mean()) if both.any() else 0.0
    mean = float(np.abs(error).mean()) if both.any() else 0.0
    return share, (
        f"{share:.1f} % of {int(both.sum()):,} compared pixels are more than 5 % off, "
        f"the mean error is {mean:.2f} m"
    )


def _thick(truth: Depth) -> Depth:
    """Sparse depth with each value over 3 x 3 pixels, the nearest on top; dense depth as it is."""
    return truth if (~np.isnan(truth)).mean() > 0.3 else spread_depth(truth, 1)


def _at(truth: Depth, depth: Depth) -> Depth:
    """The depth at each pixel with truth, spread as :func:`_thick` spreads the truth."""
    thick = _thick(truth)
    result = np.full_like(depth, np.nan)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            moved = np.roll(truth, (down, right), (0, 1))
            result = np.where(moved == thick, np.roll(depth, (down, right), (0, 1)), result)
    return result


def _photo(stream: CameraStream | None, name: str) -> dict[str, Picture]:
    photo = photo_of(stream, name)
    return {} if photo is None else {"image": photo}
