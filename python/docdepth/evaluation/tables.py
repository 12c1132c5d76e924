"""Tables of metrics for terminals, reports and Markdown pages."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, TypeVar


@dataclass(frozen=True)
class Table:
    """A title, a header, rows of text, and an optional note below them."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""

    def markdown(self) -> str:
        """The table as Markdown, with the title above and the note below."""
        lines = [self.header, tuple("---" for _ in self.header), *self.rows]
        body = "\n".join("| " + " | ".join(line) + " |" for line in lines)
        note = f"\n{self.note}\n" if self.note else ""
        return f"{self.title}\n\n{body}\n{note}"

    def __str__(self) -> str:
        widths = [max(map(len, column)) for column in zip(self.header, *self.rows, strict=True)]
        lines = [
            "  ".join(
                cell.ljust(width) if k == 0 else cell.rjust(width)
                for k, (cell, width) in enumerate(zip(row, widths, strict=True))
            )
            for row in (self.header, *self.rows)
        ]
        return "\n".join([self.title, *lines, *([self.note] if self.note else [])])


class Figures:
    """A dataclass of figures; what is None was not asked for."""

    derived: ClassVar[tuple[str, ...]] = ()  # properties that are figures, too
    flat: ClassVar[tuple[str, ...]] = ()  # fields whose figures stand among the others

    def as_dict(self) -> dict[str, object]:
        """All figures by name, ready for JSON; None replaces NaN."""
        result: dict[str, object] = {}
        for name in (*self.__dataclass_fields__, *self.derived):  # type: ignore[attr-defined]
            value = getattr(self, name)
            if value is not None:
                result |= plain(value) if name in self.flat else {name: plain(value)}
        return result


FiguresOf = TypeVar("FiguresOf", bound=Figures)


@dataclass(frozen=True)
class Band(Figures, Generic[FiguresOf]):
    """Figures of what lies between two borders."""

    near: float
    far: float
    figures: FiguresOf
    flat = ("figures",)

    def __str__(self) -> str:
        far = "" if math.isinf(self.far) else f"{self.far:g}"
        return f"{self.near:g}..{far}"


def plain(value: Any) -> Any:
    """Figures, dicts, lists and numbers as JSON can store them: None replaces NaN and infinity."""
    if isinstance(value, Figures):
        return value.as_dict()
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def ratio(part: float, whole: float) -> float:
    """``part / whole``; NaN if ``whole`` is zero."""
    return part / whole if whole else math.nan


def percent(part: float, whole: float) -> float:
    """``part / whole`` in percent; NaN if ``whole`` is zero."""
    return 100.0 * ratio(part, whole)


def number(value: float, digits: int) -> str:
    """A metric as text; a dash if it is NaN."""
    return "-" if math.isnan(value) else f"{value:.{digits}f}"
