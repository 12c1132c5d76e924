"""The type stubs of the compiled module say what it really has."""

from __future__ import annotations

import ast
import inspect
from pathlib import Path

import docdepth
import docdepth._core as _core


def _name(member: ast.stmt) -> str:
    if isinstance(member, ast.FunctionDef):
        return member.name
    target = getattr(member, "target", None)
    return target.id if isinstance(target, ast.Name) else "__other__"


def test_stubs_are_current() -> None:
    tree = ast.parse((Path(docdepth.__file__).parent / "_core.pyi").read_text())
    described = {
        node.name: {_name(member) for member in node.body}
        if isinstance(node, ast.ClassDef)
        else None
        for node in tree.body
        if isinstance(node, ast.FunctionDef | ast.ClassDef)
    }
    real = {name: value for name, value in vars(_core).items() if not name.startswith("__")}
    assert set(described) == set(real), "run: make stubs"
    for name, value in real.items():
        if inspect.isclass(value):
            methods = {k for k in vars(value) if not k.startswith("_")}
            stated = {k for k in described[name] or () if not k.startswith("_")}
            assert stated == methods, f"{name}: run: make stubs"
            continue
        # pybind11 writes the signature into the first line of the docstring.
        arguments = [
            a.arg
            for n in tree.body
            if isinstance(n, ast.FunctionDef) and n.name == name
            for a in n.args.args
        ]
        written = value.__doc__.splitlines()[0]
        assert all(f"{a}:" in written for a in arguments), f"{name}: run: make stubs"
