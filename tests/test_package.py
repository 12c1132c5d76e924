"""What a package registry shows of docdepth, and what its metadata promises."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest
import yaml

tomllib = pytest.importorskip("tomllib")  # Python 3.11

ROOT = Path(__file__).parent.parent
ADDRESS = "https://example.org/someone/docdepth"
PROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page() -> ModuleType:
    spec = importlib.util.spec_from_file_location("page", ROOT / ".ci" / "project_page.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_link_of_a_released_readme_is_absolute_and_leads_to_a_file(page: ModuleType) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)\s]+)", page.absolute(text, ADDRESS, "v1"))
    assert len(links) == len(re.findall(r"\]\(", text))
    inside = [link for link in links if link.startswith(ADDRESS)]
    assert len(inside) > 10
    for link in inside:
        view, revision, file = link.removeprefix(f"{ADDRESS}/").partition("#")[0].split("/", 2)
        assert revision == "v1"
        assert view == ("raw" if file.endswith((".jpg", ".webp")) else "blob")
        assert (ROOT / file).exists()
    assert all(link.startswith("https://") for link in links)


def test_released_metadata_names_the_repository(page: ModuleType) -> None:
    urls = tomllib.loads(page.with_addresses(PROJECT, ADDRESS))["project"]["urls"]
    assert urls["Repository"] == ADDRESS
    assert urls["Issues"] == f"{ADDRESS}/issues"
    assert urls["Paper"].startswith("https://arxiv.org/")


def test_classifiers_name_the_versions_that_wheels_are_built_for() -> None:
    project = tomllib.loads(PROJECT)
    built = project["tool"]["cibuildwheel"]["build"]
    versions = [f"3.{minor}" for minor in re.findall(r"cp3(\d+)-", built)]
    head = "Programming Language :: Python :: "
    named = [c.removeprefix(head) for c in project["project"]["classifiers"] if head in c]
    assert named == ["3", *versions]
    assert project["project"]["requires-python"] == f">={versions[0]}"


def test_the_recipe_of_conda_asks_for_what_the_wheel_does() -> None:
    recipe = yaml.safe_load((ROOT / "recipe" / "recipe.yaml").read_text(encoding="utf-8"))
    project = tomllib.loads(PROJECT)["project"]
    assert recipe["context"]["version"] == project["version"]
    wanted = [
        text.replace("opencv-python-headless", "py-opencv") for text in project["dependencies"]
    ]
    wanted.append(f"python{project['requires-python']}")
    assert sorted(text.replace(" ", "") for text in recipe["requirements"]["run"]) == sorted(
        text.lower() for text in wanted
    )
