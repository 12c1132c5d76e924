"""Parameters: presets, single values, mistakes."""

import numpy as np
import pytest
import yaml

import docdepth._core as _core
from docdepth._text import parse_settings
from docdepth.config import GroundParameters, parameters
from docdepth.errors import ConfigError
from docdepth.io.run_folder import RunFolder
from docdepth.parameter_table import parameter_table


def test_paper_preset_is_the_papers_text():
    paper = parameters("paper")
    assert (paper.ground.chunk_length, paper.ground.voxel_size, paper.ground.seed_radius) == (
        500, 0.03, 2,
    )  # fmt: skip
    assert (paper.ground.neighbors, paper.ground.plane_distance, paper.ground.max_slope_deg) == (
        30, 0.04, 15,
    )  # fmt: skip
    voting = paper.dynamics
    assert (voting.fine_spacing, voting.coarse_spacing) == (2, 10)
    assert (voting.fine_radius, voting.coarse_radius) == (20, 50)
    assert (voting.resolution_deg, voting.window, voting.tolerance) == (0.2, 5, 0.2)
    assert (voting.vote_model, voting.time_spacing, voting.evidence) == ("range_image", 0, "points")
    assert (paper.ground.seed_quantile, paper.ground.step_height) == (0, 0)
    sizes = paper.render
    assert sizes.static_size == (50, 3)
    assert sizes.dynamic_size == (80, 35)


def test_a_value_is_replaced_by_name():
    changed = parameters(
        "default", parse_settings(["dynamics.tolerance=0.3", "ground.neighbors=20"])
    )
    assert changed.dynamics.tolerance == 0.3
    assert changed.ground.neighbors == 20


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("dynamics.tau=0.3", r"unknown parameter 'dynamics\.tau'; that stage knows .*tolerance"),
        ("voting.tolerance=1", r"unknown parameter 'voting\.tolerance'.*odometry, ground"),
        (
            "dynamics.tolerance=-1",
            r"^dynamics\.tolerance = -1: it must be a number from 0.001 to 10 m$",
        ),
        ("dynamics.tolerance=wide", r"^dynamics\.tolerance = 'wide': it must be a number from"),
        ("dynamics.tolerance=yes", r"^dynamics\.tolerance = True: no parameter is a switch"),
        ("dynamics.tolerance=.nan", r"^dynamics\.tolerance = nan: it must be a number from"),
        ("dynamics.window=4", r"^dynamics\.window = 4: the window has a centre pixel"),
        ("dynamics.window=4.5", r"^dynamics\.window = 4.5: it must be a whole number from 1 to 15"),
        ("dynamics.evidence=[1]", r"evidence = \[1\]: it must be one of points, objects, tracks$"),
        (
            "dynamics.fine_radius=1",
            r"^dynamics\.fine_radius = 1 m must not be below dynamics\.fine_s",
        ),
        (
            "dynamics.coarse_spacing=0.1",
            r"1600 key frames at dynamics\.coarse_spacing = 0.1 m; 400",
        ),
        (
            "odometry.min_range=100",
            r"^odometry\.min_range = 100 m must be below odometry\.max_range",
        ),
        (
            "output.format=jpg",
            r"^output\.format = 'jpg': it must be one or several of png, exr-half",
        ),
        ("output.format=", r"^output\.format = None: it must be one or several of png"),
        (
            "render.static_size=[a, 3]",
            r"size = 'a': it must be two numbers from 0.1 to 2000 pixels",
        ),
        ("render.static_size=[3, 50]", r"^render\.static_size = .*sigma_max, must not be below"),
        ("render.max_depth=1:20", r"^render\.max_depth = '1:20': it must be a number"),
        (
            "odometry.voxel_size=[1",
            r"^--set 'odometry\.voxel_size=\[1': the value '\[1' cannot be read",
        ),
        ("tolerance", "^--set 'tolerance': write stage.name=value"),
    ],
)
def test_mistakes_are_named(setting, message):
    with pytest.raises(ConfigError, match=message):
        parameters("default", parse_settings([setting]))


_HOSTILE = [
    *(0, -1, 1, 1e-9, 1e9, -1e300, 1e300, 2**31, 2**63, 2**200, float("nan"), float("inf")),
    *(None, True, "", "x", "1", "1e400", b"1", [], [1], [1, 2], [2, 1], [2, "a"], {}, {"a": 1}),
    *((), (1, 2, 3), {1: 2}, [[1], [2]], 1 + 2j, "\x00", "a,b,,c", object()),
]


def _accepted(name, value):
    """The value as it is understood, or the refusal."""
    stage, _, key = name.partition(".")
    try:
        return getattr(getattr(parameters("default", {name: value}), stage), key)
    except ConfigError as error:
        return error


@pytest.mark.parametrize("about", parameter_table(), ids=lambda about: about["name"])
def test_any_value_is_accepted_or_refused_in_a_sentence(about):
    """Nothing else leaves ``parameters``, and what is accepted lies in the stated range."""
    name, numbers = about["name"], np.random.default_rng(0)
    low, _, high = about["range"].partition(" to ")
    random = [float(x) for x in numbers.normal(0, 1, 40) * 10.0 ** numbers.integers(-12, 12, 40)]
    ends = [float(low), float(high)] if high else []
    for value in [*_HOSTILE, *random, *ends, *np.nextafter(ends, [-np.inf, np.inf][: len(ends)])]:
        accepted = _accepted(name, value)
        if isinstance(accepted, ConfigError):
            assert name in str(accepted)
            assert "pydantic" not in str(accepted)
            assert len(str(accepted)) < 300
        elif high:
            assert np.all((np.array(accepted) >= float(low)) & (np.array(accepted) <= float(high)))


@pytest.mark.parametrize(
    ("tree", "message"),
    [
        (None, "parameters are a table of odometry, .*, not None"),
        ([1], r"not \[1\]"),
        ({"ground": 3}, "ground = 3: write a table of parameters"),
        ({"surfaces": {}}, "unknown stage 'surfaces'; there are odometry"),
        ({"preset": "best"}, "preset = 'best': it must be 'default' or 'paper'"),
        ({"preset": ["x"]}, "preset = .*: it must be 'default' or 'paper'"),
        ({1: 2}, "1"),
        ({"ground": {1: 2}}, "ground.1"),
        ({"render": {"static_size": 5, "static_size_max": 4}}, "render.static_size = "),
        ({"ground": {"voxel_size": 1e-9}}, r"ground\.voxel_size = 1e-09: it must be a number from"),
    ],
)
def test_a_broken_run_file_is_named(tree, message, tmp_path):
    manifest = {"parameters": tree, "stages": {}}
    (tmp_path / "run.yaml").write_text(yaml.safe_dump(manifest))
    with pytest.raises(ConfigError, match=rf"^{tmp_path / 'run.yaml'}: .*{message}"):
        _ = RunFolder.open(tmp_path).parameters


def test_the_table_names_every_parameter():
    table = {about["name"]: about for about in parameter_table()}
    assert len(table) == 35
    assert table["dynamics.tolerance"] == {
        "name": "dynamics.tolerance",
        "default": 0.2,
        "paper": 0.2,
        "range": "0.001 to 10",
        "unit": "m",
        "symbol": "tau",
        "description": "range difference of returns that are the same",
    }
    assert table["render.behind"]["paper"] == 0.5
    assert table["dynamics.evidence"]["range"] == "points, objects, tracks"
    assert table["render.static_size"]["range"] == "0.1 to 2000"
    assert all(about["description"] and about["range"] for about in table.values())


def test_unknown_preset():
    with pytest.raises(ConfigError, match="there are 'default' and 'paper'"):
        parameters("best")


def test_the_core_has_the_same_defaults():
    """Constants of C++ are the defaults of its structures; public parameters agree with them."""
    p = parameters()
    ground = _core.GroundParameters()
    for name in set(GroundParameters.model_fields) - {"chunk_length", "max_slope_deg"}:
        assert getattr(ground, name) == getattr(p.ground, name), name
    assert ground.max_slope == np.radians(p.ground.max_slope_deg)
    image = _core.MeshImageParameters()
    assert image.resolution == np.radians(p.dynamics.resolution_deg)
    assert image.window == p.dynamics.window
    assert np.float32(image.tolerance) == np.float32(p.dynamics.tolerance)


def test_constants_given_in_degrees():
    mesh, image = _core.MeshParameters(), _core.MeshImageParameters()
    assert np.float32(mesh.max_gap) == np.float32(np.radians(4))
    assert np.float32(image.level_cosine) == np.float32(np.cos(np.radians(25)))


def test_numbers_with_zeros_in_front_are_decimal():
    assert parse_settings(["dynamics.window=011"]) == {"dynamics.window": 11}
