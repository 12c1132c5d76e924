"""The command line as a shell would call it: its exit code, output and messages."""

from __future__ import annotations

import io
import logging
import os
import sys
from typing import NamedTuple

import pytest

from docdepth.cli import main


class Ended(NamedTuple):
    code: int
    out: str
    err: str


@pytest.fixture
def docdepth(monkeypatch):
    """Call main() with arguments, as the script ``docdepth`` does; no other process is needed."""

    def call(*arguments) -> Ended:
        streams = [io.TextIOWrapper(io.BytesIO(), encoding="utf-8") for _ in range(2)]
        handlers, level = logging.getLogger().handlers[:], logging.getLogger().level
        with monkeypatch.context() as patch:
            patch.setattr(sys, "argv", ["docdepth", *map(os.fsdecode, map(_text, arguments))])
            # As in a script: `python -m pytest` has a package, by whose name help would call us.
            patch.setattr(sys.modules["__main__"], "__package__", None, raising=False)
            patch.setattr(sys, "stdout", streams[0])
            patch.setattr(sys, "stderr", streams[1])
            with pytest.raises(SystemExit) as ended:
                main()
            for stream in streams:
                stream.flush()
        logging.getLogger().handlers[:], logging.getLogger().level = handlers, level
        texts = [stream.buffer.getvalue().decode() for stream in streams]
        return Ended(ended.value.code or 0, *texts)

    return call


def _text(argument) -> str | bytes:
    return argument if isinstance(argument, (str, bytes)) else str(argument)
