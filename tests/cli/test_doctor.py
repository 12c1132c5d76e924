"""doctor imports what it reports, and knows every extra."""

from __future__ import annotations

import json
import sys
from email.message import Message

import pytest

from docdepth.cli import doctor as examined
from docdepth.cli.doctor import examine_all, requirements


@pytest.fixture
def metadata(monkeypatch):
    """docdepth as if it were installed with these requirements."""
    meta = Message()
    for extra in ("viz", "synth", "dev", "some"):
        meta["Provides-Extra"] = extra
    for text in (
        "numpy>=1.24",
        "broken-library>=1",
        'open3d>=0.18; extra == "viz"',
        "not-there ; extra == 'synth'",
        'docdepth[viz]; extra == "dev"',
        'rich; extra == "dev"',
        'rich; extra == "some"',
        'gone-1; extra == "some"',
        'gone-2; extra == "some"',
    ):
        meta["Requires-Dist"] = text
    versions = {"numpy": "2.0", "broken-library": "1.1", "open3d": "0.19", "rich": "13"}

    def version(name):
        if name not in versions:
            raise examined.importlib.metadata.PackageNotFoundError(name)
        return versions[name]

    modules = {"numpy": ["numpy"], "broken": ["broken_library"], "open3d": ["open3d"]}
    monkeypatch.setattr(examined.importlib.metadata, "metadata", lambda name: meta)
    monkeypatch.setattr(examined.importlib.metadata, "version", version)
    monkeypatch.setattr(examined.importlib.metadata, "packages_distributions", lambda: modules)
    real = examined.importlib.import_module
    fails = {
        "open3d": OSError("libusb-1.0.so.0: cannot open shared object file"),
        "broken": ImportError("undefined symbol"),
    }

    def import_module(name):
        if name in fails:
            raise fails[name]
        return real(name)

    monkeypatch.setattr(examined.importlib, "import_module", import_module)


def test_extras_are_those_of_the_package(metadata):
    assert requirements() == {
        "": ["numpy", "broken-library"],
        "viz": ["open3d"],
        "synth": ["not-there"],
        "dev": ["rich"],
        "some": ["rich", "gone-1", "gone-2"],
    }


def test_what_cannot_be_imported_is_not_well(metadata):
    rows = {name: (finding, well) for name, finding, well in examine_all()}
    assert rows["numpy"] == ("2.0", True)
    assert rows["broken-library"] == ("1.1 cannot be imported: undefined symbol", False)
    assert rows["extra viz"] == (
        "open3d 0.19 cannot be imported: libusb-1.0.so.0: cannot open shared object file; "
        "on Debian: apt install libusb-1.0-0",
        False,
    )
    assert rows["extra synth"] == ('not installed; pip install "docdepth[synth]"', False)
    assert rows["extra some"] == ('gone-1, gone-2 missing; pip install "docdepth[some]"', False)
    assert rows["extra dev"] == ("rich 13", True)


def test_doctor_in_json(docdepth, metadata):
    rows = json.loads(docdepth("doctor", "--json").out)
    assert {"name": "Python", "finding": sys.version.split()[0], "ok": True} in rows
    assert any(row["name"] == "renderer cpu" and row["ok"] for row in rows)
    assert {row["name"] for row in rows if not row["ok"]} >= {"extra viz", "broken-library"}
