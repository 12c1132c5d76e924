"""Parameters: presets, single values, mistakes."""

import pytest

from docdepth.config import parameters, parse_settings
from docdepth.errors import ConfigError


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
        ("dynamics.tolerance=-1", r"dynamics\.tolerance = -1.*greater than 0"),
        ("dynamics.tolerance=wide", r"dynamics\.tolerance = 'wide'"),
        ("tolerance", "write stage.name=value"),
    ],
)
def test_mistakes_are_named(setting, message):
    with pytest.raises(ConfigError, match=message):
        parameters("default", parse_settings([setting]))


def test_unknown_preset():
    with pytest.raises(ConfigError, match="there are 'default' and 'paper'"):
        parameters("best")
