"""Figures as text: what a terminal, a report and a Markdown page print alike."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Table:
    """A title, a header and rows of text."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def markdown(self) -> str:
        """The table as Markdown, its title above it."""
        lines = [self.header, tuple("---" for _ in self.header), *self.rows]
        body = "\n".join("| " + " | ".join(line) + " |" for line in lines)
        return f"{self.title}\n\n{body}\n"

    def __str__(self) -> str:
        widths = [max(map(len, column)) for column in zip(self.header, *self.rows, strict=True)]
        lines = [
            "  ".join(
                cell.ljust(width) if k == 0 else cell.rjust(width)
                for k, (cell, width) in enumerate(zip(row, widths, strict=True))
            )
            for row in (self.header, *self.rows)
        ]
        return "\n".join([self.title, *lines])


def plain(value: Any) -> Any:
    """A tree of dicts, lists and numbers as JSON can hold it: None for NaN and infinity."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def ratio(part: float, whole: float) -> float:
    """``part / whole``, NaN where there is nothing to divide by."""
    return part / whole if whole else math.nan


def percent(part: float, whole: float) -> float:
    """``part`` of ``whole`` in percent, NaN where there is nothing to divide by."""
    return 100.0 * ratio(part, whole)


def number(value: float, digits: int) -> str:
    """A figure as text; a dash where it is undefined."""
    return "-" if math.isnan(value) else f"{value:.{digits}f}"
