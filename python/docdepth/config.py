"""Every parameter of the method: name, default, range, unit and the paper's symbol.

``preset("default")`` is what measured best, ``preset("paper")`` the paper's text to the letter.
"""

from __future__ import annotations

from typing import Any, Literal

import yaml
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PositiveFloat,
    ValidationError,
    field_validator,
)

from docdepth.errors import ConfigError

Layer = Literal["class", "time", "range", "support", "std", "normal", "confidence"]
DepthFormat = Literal["png", "exr-half", "exr", "tiff", "npz", "npy"]

Preset = Literal["default", "paper"]

_Size = tuple[PositiveFloat, PositiveFloat]


class _Stage(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class OdometryParameters(_Stage):
    """LiDAR odometry and deskewing (paper III-B; kiss-icp, then small_gicp)."""

    max_range: float = Field(100.0, gt=0, description="points beyond are not registered [m]")
    min_range: float = Field(3.0, ge=0, description="points nearer are not registered [m]")
    voxel_size: float = Field(1.0, gt=0, description="edge of a voxel of kiss-icp's map [m]")
    passes: int = Field(
        3,
        ge=1,
        le=5,
        description="registrations of the whole drive: one by kiss-icp, the others by small_gicp",
    )
    blooming_deg: float = Field(
        0.0,
        ge=0,
        le=5,
        description="ghost returns up to this far beside retro-reflectors are removed [deg]",
    )


class GroundParameters(_Stage):
    """Ground growing (paper III-C1)."""

    chunk_length: float = Field(500.0, gt=0, description="path length of a chunk, l [m]")
    chunk_overlap: float = Field(
        100.0, ge=0, description="path before and after a chunk that is merged with it [m]"
    )
    voxel_size: float = Field(0.03, gt=0, description="edge of a voxel, s [m]")
    seed_radius: float = Field(2.0, gt=0, description="seeds lie this near a pose, r_seed [m]")
    seed_quantile: float = Field(
        0.1, ge=0, lt=1, description="share of the voxels there that lie below the seed [-]"
    )
    least_share: float = Field(
        0.01,
        ge=0,
        le=1,
        description="with less ground than this seeds are sought twice as far away, to 16 m [-]",
    )
    step_height: float = Field(
        0.25, ge=0, description="ground goes on behind kerbs up to this high; 0: it does not [m]"
    )
    neighbors: int = Field(30, ge=3, le=200, description="neighbours of a front point, k_nn")
    plane_distance: float = Field(0.04, gt=0, description="distance to the plane, delta [m]")
    max_slope_deg: float = Field(15.0, gt=0, lt=90, description="lean of a normal, alpha [deg]")


class SurfaceParameters(_Stage):
    """A sweep as triangles between neighbouring returns; voting and rendering share them."""

    max_gap_deg: float = Field(
        4.0, gt=0, lt=90, description="longest side of a triangle, seen from the sensor [deg]"
    )
    jump_ratio: float = Field(
        4.0, gt=0, description="range difference over distance across, of a depth jump [-]"
    )
    noise: float = Field(0.1, ge=0, description="smaller range differences are no jump [m]")
    flatness: float = Field(
        0.1, ge=0, description="returns that continue a plane this well are one surface [m]"
    )


class VotingParameters(_Stage):
    """Key frames, and how they vote (paper III-C2, Algorithm 1)."""

    against: Literal["pixels", "surface"] = Field(
        "surface", description="what points are held against: a key frame's pixels or its surface"
    )
    fine_spacing: float = Field(2.0, gt=0, description="spacing of fine key frames, d_fine [m]")
    coarse_spacing: float = Field(5.0, gt=0, description="of coarse key frames, d_coarse [m]")
    fine_radius: float = Field(20.0, gt=0, description="arc length to fine ones, R_fine [m]")
    coarse_radius: float = Field(80.0, gt=0, description="arc length to coarse, R_coarse [m]")
    time_spacing: float = Field(
        0.5, ge=0, description="and a key frame as often, where the ego crawls; 0 for none [s]"
    )
    time_radius: float = Field(10.0, ge=0, description="time to these [s]")
    end_spacing: float = Field(
        0.4, ge=0, description="of key frames between a sweep and an end that is near [s]"
    )
    end_radius: float = Field(
        3.0, ge=0, description="that near an end of the drive; 0 adds no key frames [s]"
    )
    resolution_deg: float = Field(0.2, gt=0, le=5, description="pixel, d_theta = d_phi [deg]")
    window: int = Field(5, ge=1, le=15, description="edge of the compared window, w [pixels]")
    tolerance: float = Field(0.2, gt=0, description="range tolerance, tau [m]")
    across: float = Field(0.2, gt=0, description="nearer to a plane is on it [m]")
    along: float = Field(0.3, gt=0, description="the same, along the line of sight [m]")
    along_growth: float = Field(0.01, ge=0, description="growth of that with range [m/m]")
    level_across: float = Field(0.08, gt=0, description="`across` of planes that lie flat [m]")
    level_along: float = Field(0.1, gt=0, description="`along` of planes that lie flat [m]")
    ground_across: float = Field(
        0.03, gt=0, description="`across` of these if the point or plane is called ground [m]"
    )
    level_lean_deg: float = Field(
        25.0, ge=0, lt=90, description="a plane leaning no more lies flat, as ground does [deg]"
    )
    beam: float = Field(
        0.15, gt=0, description="what lies farther from a measured line of sight is not seen [m]"
    )

    @field_validator("window")
    @classmethod
    def _odd(cls, window: int) -> int:
        if window % 2 == 0:
            raise ValueError("the window has a centre pixel, so its edge is odd")
        return window


class DynamicsParameters(VotingParameters):
    """Key frames, votes, and what makes classes of votes (paper III-C2)."""

    objects: bool = Field(True, description="share evidence within connected objects")
    link: float = Field(
        0.3, gt=0, description="neighbours farther apart belong to different objects [m]"
    )
    link_growth: float = Field(
        0.05, ge=0, description="or, where beams are wider apart, than so much of their range [-]"
    )
    companions: int = Field(
        6, ge=1, description="connected dynamic points that need no other evidence"
    )
    company: float = Field(
        1.0, gt=0, description="single points are dynamic this near to those [m]"
    )
    clear_votes: int = Field(2, ge=1, description="or with as many dynamic votes")
    clear_ratio: float = Field(4.0, ge=1, description="and so many times more than static ones")
    object_points: int = Field(10, ge=1, description="points of an object, at least")
    object_share: float = Field(
        0.5, gt=0, le=1, description="share of its points with votes that, dynamic, makes all so"
    )
    object_least: float = Field(
        0.1, gt=0, le=1, description="and share of all its points, votes or not"
    )
    object_width: float = Field(
        1.5, ge=0, description="extent of what may stand a while and move, from above [m]"
    )
    object_height: float = Field(0.3, ge=0, description="and its height [m]")
    freed_share: float = Field(
        0.6, gt=0, le=1, description="share of its points whose place was free at another time"
    )
    freed_votes: int = Field(2, ge=1, description="dynamic votes that show a place was free")
    freed_ratio: float = Field(
        8.0,
        ge=1,
        description="most static votes that go with each of them; with more a point stays"
        " though its object moves",
    )
    loose_votes: int = Field(
        2, description="a loose point inside a moving object has so many more static votes at most"
    )
    tracks: bool = Field(True, description="carry evidence over time along objects (of `objects`)")
    track_sightings: int = Field(
        3, ge=2, description="sweeps whose votes say that an object moves, at least"
    )
    track_distance: float = Field(1.0, ge=0, description="and its way, from above, at least [m]")
    track_speed: float = Field(40.0, gt=0, description="nothing is faster [m/s]")
    track_gap: float = Field(1.0, ge=0, description="an object unseen for longer is lost [s]")
    track_hold: float = Field(5.0, ge=0, description="the same of one that stands [s]")
    track_stood: float = Field(
        0.8,
        ge=0,
        le=1,
        description="share of what is left of an object that moves in part, always seen taken"
        " (`freed_ratio` static votes, no dynamic one), above which it is another thing",
    )
    track_window: float = Field(
        0.3,
        ge=0,
        description="sightings that near tell the box in which points move; 0: none [s]",
    )

    def voting(self) -> dict[str, Any]:
        """The values that votes depend on; all others make classes of votes."""
        return self.model_dump(include=set(VotingParameters.model_fields))


class RenderParameters(_Stage):
    """Which sweeps an image is drawn from, and how (paper V-B).

    Differences from the paper's text:

    - Both presets: the paper names ``d_min`` and ``d_crop`` without values and has no far plane.
      ``behind`` of the preset ``paper`` (0.5 m, about one sweep as in the authors' release),
      ``crop`` and ``max_depth`` are docdepth's own.
    - Both presets: arc length ignores steps below 5 cm, so that the jitter of a standing vehicle
      adds no path. Of sweeps at one arc length, the nearest in time is drawn.
    - Both presets: points closer than 1.65 m to the camera, where the paper's formula for the size
      of a splat diverges, get the largest size.
    - Both presets: sizes of splats are pixels of the authors' image (1920 x 1080) and are not
      scaled to other images.
    - ``default`` draws triangles between neighbouring returns, compares the rays of several sweeps
      at depth edges and moves dynamic objects to the image's time. It also has its own ``behind``,
      ``ahead`` and ``step``: the paper's ``d_max`` is 100 m, its ``d_step`` 0.2 m.
    """

    primitive: Literal["splats", "triangles"] = Field(
        "triangles",
        description="what a sweep is drawn as: the paper's splats, or triangles between returns",
    )
    behind: float = Field(
        15.0, ge=0, description="path behind the camera from which static points come, d_min [m]"
    )
    ahead: float = Field(80.0, gt=0, description="the same ahead of the camera, d_max [m]")
    step: float = Field(
        0.25, gt=0, description="path between sweeps that static points come from, d_step [m]"
    )
    crop: float = Field(
        300.0, gt=0, description="maximum range of static points from their LiDAR, d_crop [m]"
    )
    max_depth: float = Field(250.0, gt=0, description="far plane of the depth map [m]")
    visibility_sweeps: int = Field(
        15,
        ge=0,
        le=100,
        description="sweeps whose rays decide between depths at edges; 0: the nearest sweep wins",
    )
    static_size: _Size = Field(
        (50.0, 3.0), description="height of static splats, sigma_max and sigma_min [pixels]"
    )
    dynamic_size: _Size = Field(
        (80.0, 35.0), description="height of dynamic splats, sigma_max and sigma_min [pixels]"
    )

    @field_validator("static_size", "dynamic_size", mode="before")
    @classmethod
    def _pair(cls, size: Any) -> Any:
        return size.split(",") if isinstance(size, str) else size


class OutputParameters(_Stage):
    """The files of each depth map."""

    format: tuple[DepthFormat, ...] = Field(
        ("png",), min_length=1, description="file formats; PNG holds uint16, all others floats"
    )
    scale: float = Field(256.0, gt=0, description="value of one metre in a PNG [1/m]")
    layers: tuple[Layer, ...] = Field((), description="further layers, written per pixel")

    @field_validator("format", "layers", mode="before")
    @classmethod
    def _listed(cls, names: Any) -> Any:
        names = names.split(",") if isinstance(names, str) else names
        return tuple(dict.fromkeys(names)) if isinstance(names, (list, tuple)) else names

    @field_validator("format")
    @classmethod
    def _one_exr(cls, format: tuple[str, ...]) -> tuple[str, ...]:
        if {"exr", "exr-half"} <= set(format):
            raise ValueError("exr and exr-half share one file name; choose one of them")
        return format


class Parameters(_Stage):
    """All stages of a run. Unknown keys are errors."""

    preset: Preset = "default"
    odometry: OdometryParameters = OdometryParameters()
    ground: GroundParameters = GroundParameters()
    surface: SurfaceParameters = SurfaceParameters()
    dynamics: DynamicsParameters = DynamicsParameters()
    render: RenderParameters = RenderParameters()
    output: OutputParameters = OutputParameters()


_STAGES: dict[str, type[_Stage]] = {
    "odometry": OdometryParameters,
    "ground": GroundParameters,
    "surface": SurfaceParameters,
    "dynamics": DynamicsParameters,
    "render": RenderParameters,
    "output": OutputParameters,
}

# Where the paper's text differs from what measured best, a stage at a time.
_PAPER: dict[str, dict[str, Any]] = {
    "ground": {"chunk_overlap": 0, "seed_quantile": 0, "least_share": 0, "step_height": 0},
    "dynamics": {
        "against": "pixels",
        "coarse_spacing": 10,
        "coarse_radius": 50,
        "time_spacing": 0,
        "end_radius": 0,
        "objects": False,
        "tracks": False,
    },
    "render": {"primitive": "splats", "behind": 0.5, "ahead": 100, "step": 0.2},
}


def parameters(preset: Preset = "default", settings: dict[str, Any] | None = None) -> Parameters:
    """Parameters of a preset with single values replaced.

    Parameters
    ----------
    preset : {"default", "paper"}
        ``paper`` is the paper's text to the letter, ``default`` what measured best.
    settings : dict, optional
        Values by dotted name, ``{"dynamics.tolerance": 0.3}``.

    Raises
    ------
    ConfigError
        The preset or a name is unknown, or a value is outside its range.
    """
    if preset not in ("default", "paper"):
        raise ConfigError(f"unknown preset {preset!r}; there are 'default' and 'paper'")
    tree: dict[str, Any] = {"preset": preset}
    if preset == "paper":
        tree |= {stage: dict(values) for stage, values in _PAPER.items()}
    for name, value in (settings or {}).items():
        stage, _, key = name.partition(".")
        if not key or stage not in _STAGES:
            raise ConfigError(
                f"unknown parameter {name!r}; write stage.name with a stage of {', '.join(_STAGES)}"
            )
        tree.setdefault(stage, {})[key] = value
    try:
        return Parameters.model_validate(tree)
    except ValidationError as error:
        raise ConfigError(_explain(error)) from None


def parse_settings(assignments: list[str]) -> dict[str, Any]:
    """``["dynamics.tolerance=0.3"]`` as a dict; values are read as YAML.

    Raises
    ------
    ConfigError
        An assignment has no equals sign.
    """
    settings: dict[str, Any] = {}
    for assignment in assignments:
        name, equals, value = assignment.partition("=")
        if not equals:
            raise ConfigError(f"--set {assignment!r}: write stage.name=value")
        settings[name.strip()] = yaml.safe_load(value)
    return settings


def _explain(error: ValidationError) -> str:
    lines = []
    for problem in error.errors():
        name = ".".join(str(part) for part in problem["loc"])
        if problem["type"] == "extra_forbidden":
            known = ", ".join(_STAGES[str(problem["loc"][0])].model_fields)
            lines.append(f"unknown parameter {name!r}; that stage knows {known}")
        else:
            lines.append(f"{name} = {problem['input']!r}: {problem['msg']}")
    return "; ".join(lines)
