"""The house stays one that a newcomer can walk through: bounds on what `structure.py` counts."""

import re
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from structure import House

HOUSE = House(Path(__file__).resolve().parents[1])


def test_few_modules_lie_at_the_top():
    assert len(HOUSE.modules_at_the_top()) <= 10


def test_rooms_do_not_import_each_other_in_a_circle():
    assert max(HOUSE.floors().values()) <= len(HOUSE.rooms())


def test_modules_do_not_import_each_other_in_a_circle():
    TopologicalSorter(HOUSE.imports()).prepare()


def test_no_function_is_longer_than_sixty_lines_of_code():
    assert [f for f in HOUSE.functions() if f.lines > 60] == []


def test_few_parameters_are_public():
    assert len(HOUSE.public_fields()) <= 35


def test_the_counts_see_what_they_count(tmp_path: Path):
    package = tmp_path / "python" / "docdepth"
    for room in ("one", "two"):
        (package / room).mkdir(parents=True)
    twice = "".join(f"    x{k} = {k}\n" for k in range(70))
    (package / "one" / "a.py").write_text(f'def long():\n    """No\n    code."""\n{twice}')
    (package / "two" / "b.py").write_text(f"from docdepth.one import a\n\n\ndef b():\n{twice}")
    (package / "config.py").write_text("class A:\n    x: int = Field(1)\n    y: int = 2\n")
    (tmp_path / "cpp").mkdir()
    body = "// no code\n" * 9 + "  f();\n" * 61
    (tmp_path / "cpp" / "c.cpp").write_text(f"namespace n {{\nvoid c(int x) {{\n{body}}}\n}}\n")
    house = House(tmp_path)
    lengths = {f.name: f.lines for f in house.functions()}
    assert lengths == {"long": 71, "b": 71, "c": 63}
    assert house.arrows() == {("two", "one")}
    assert house.floors() == {"one": 1, "two": 2, "config": 1}
    assert house.public_fields() == ["A.x"]
    assert [place.split(":")[0] for place, _ in house.duplicated_blocks()] == [
        "python/docdepth/two/b.py",
        "cpp/c.cpp",
    ]
    (package / "one" / "c.py").write_text("import docdepth.two.b\n")
    with pytest.raises(ValueError, match=r"one -> two -> one|two -> one -> two"):
        House(tmp_path).floors()
    (package / "one" / "a.py").write_text("def f():\n    from docdepth.one.c import x\n")
    with pytest.raises(CycleError, match=r"docdepth\.one\.a"):
        TopologicalSorter(House(tmp_path).imports()).prepare()


def test_rooms_import_only_rooms_above_them_on_the_page_of_architecture():
    text = (HOUSE.root / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = [line for line in text.splitlines() if line.startswith("| `")]
    order = [name for row in rows for name in re.findall(r"`(\w+)`", row.split("|")[1])]
    assert set(order) == HOUSE.rooms()
    for room, imported in HOUSE.arrows():
        assert order.index(imported) < order.index(room), f"{room} imports {imported}"
