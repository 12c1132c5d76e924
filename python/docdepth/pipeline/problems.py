"""Problems of the inputs of a run: what is wrong, where, and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from docdepth.errors import Collector, DatasetError, raise_together


@dataclass(frozen=True)
class Problem:
    """One problem.

    Attributes
    ----------
    severity : {"error", "warning"}
        With an error the run would fail or give nothing of use.
    text : str
        A sentence that names file, value and remedy.
    """

    severity: Literal["error", "warning"]
    text: str


class Findings(Collector):
    """Errors and warnings of all checks."""

    def __init__(self) -> None:
        super().__init__()
        self.warnings: list[str] = []

    def error(self, text: str) -> None:
        self.errors.append(DatasetError(text))

    def warn(self, text: str) -> None:
        self.warnings.append(text)

    def all(self) -> list[Problem]:
        """Errors first, each once."""
        warnings = dict.fromkeys(self.warnings)
        return [Problem("error", str(error)) for error in self.errors] + [
            Problem("warning", text) for text in warnings
        ]


def raise_problems(problems: Sequence[Problem]) -> None:
    """Raise the errors among problems, all in one message.

    Raises
    ------
    DatasetError
        For one error its sentence, for several :class:`SeveralProblems`.
    """
    raise_together(DatasetError(p.text) for p in problems if p.severity == "error")
