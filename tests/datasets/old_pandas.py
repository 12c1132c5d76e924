"""Tables as pandas 1.0 wrote them, which the pandas of today writes in another way."""

from __future__ import annotations

import gzip
import io
import pickle
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Named:
    """A class or function that a pickle names; that of an old pandas need not exist here."""

    module: str
    name: str

    def __call__(self) -> None:
        """Pickle asks that functions can be called."""


@dataclass(frozen=True)
class Made:
    """What a pickle makes by a function, or of a class with a state."""

    by: Named
    arguments: tuple | None = None
    state: object = None


class OldPickler(pickle._Pickler):
    """Writes :class:`Named` and :class:`Made` as a program with these classes would."""

    def save(self, obj, save_persistent_id=True):
        if isinstance(obj, Named):
            self.write(f"c{obj.module}\n{obj.name}\n".encode())
        elif isinstance(obj, Made) and obj.arguments is not None:
            self.save(obj.by)
            self.save(obj.arguments)
            self.write(pickle.REDUCE)
        elif isinstance(obj, Made):
            self.save(obj.by)
            self.write(pickle.EMPTY_TUPLE + pickle.NEWOBJ)
            self.save(obj.state)
            self.write(pickle.BUILD)
        else:
            super().save(obj, save_persistent_id)


def write_table(file: Path, **columns: np.ndarray) -> None:
    """As pandas 1.0 writes a table; PandaSet is of that time."""

    def index(kind: str, values: np.ndarray, name: str | None) -> Made:
        module = "base" if kind == "Index" else "numeric"
        known = Named(f"pandas.core.indexes.{module}", kind)
        make = Named("pandas.core.indexes.base", "_new_Index")
        return Made(make, (known, {"data": values, "name": name}))

    names = list(columns)
    whole = [name for name in names if columns[name].dtype.kind == "i"]
    blocks = []
    for group in ([n for n in names if n not in whole], whole):
        values = np.stack([columns[name] for name in group])
        blocks.append((values, np.array([names.index(name) for name in group])))
    rows = np.arange(len(columns[names[0]]))
    axes = [index("Index", np.array(names, object), None), index("Int64Index", rows, "index")]
    items = [
        index("Index", np.array([names[k] for k in places], object), None) for _, places in blocks
    ]
    values = [values for values, _ in blocks]
    modern = [
        {"values": values, "mgr_locs": slice(int(places[0]), int(places[-1]) + 1, 1)}
        for values, places in blocks
    ]
    state = (axes, values, items, {"0.14.1": {"axes": axes, "blocks": modern}})
    manager = Made(Named("pandas.core.internals.managers", "BlockManager"), state=state)
    table = {"_data": manager, "_typ": "dataframe", "_metadata": [], "attrs": {}}
    stream = io.BytesIO()
    frame = Made(Named("pandas.core.frame", "DataFrame"), state=table)
    OldPickler(stream, protocol=4).dump(frame)
    file.write_bytes(gzip.compress(stream.getvalue()))
