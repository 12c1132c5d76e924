"""Every public parameter: name, default, range, unit and the paper's symbol.

The preset ``default`` is what measured best, ``paper`` follows the paper's text; where it cannot,
the class of the stage lists the difference. Everything else is a constant: of Python at the top of
the module that uses it, of C++ the default of its parameter structure.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from docdepth._text import check_key_frames, explain
from docdepth.errors import ConfigError, InputError

Layer = Literal[
    "class",
    "instance",
    "time",
    "range",
    "support",
    "std",
    "normal",
    "normal_confidence",
    "confidence",
    "seen",
]
DepthFormat = Literal["png", "exr-half", "exr", "tiff", "npz", "npy"]

Settings = Mapping[str, object]
"""Parameters by dotted name, as YAML and the command line hold them; checked when they are used."""

Preset = Literal["default", "paper"]

_Pixels = Annotated[float, Field(ge=0.1, le=2000)]
_Size = tuple[_Pixels, _Pixels]


class _Stage(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _no_switch(cls, value: Any) -> Any:
        if isinstance(value, bool):  # a number to pydantic, and what YAML makes of "on"
            raise ValueError("no parameter is a switch; write a number or a word")
        return value


class OdometryParameters(_Stage):
    """LiDAR odometry and deskewing (paper III-B)."""

    max_range: float = Field(
        100.0, ge=5, le=1000, description="points beyond are not registered [m]"
    )
    min_range: float = Field(3.0, ge=0, le=100, description="points nearer are not registered [m]")
    voxel_size: float = Field(
        1.0, ge=0.1, le=10, description="edge of a voxel of the first pass's map [m]"
    )
    loop_closure: float = Field(
        0.0,
        ge=0,
        le=0.1,
        description="streets seen again are looked for within this share of the path since then; "
        "0: no loop closure [-]",
    )
    blooming_deg: float = Field(
        0.0,
        ge=0,
        le=5,
        description="ghost returns up to this far beside retro-reflectors are removed [deg]",
    )

    @model_validator(mode="after")
    def _some_points(self) -> OdometryParameters:
        if self.min_range >= self.max_range:
            raise ValueError(
                f"odometry.min_range = {self.min_range:g} m must be below odometry.max_range = "
                f"{self.max_range:g} m; no point lies between them"
            )
        return self


class GroundParameters(_Stage):
    """Ground growing (paper IV-A).

    Differences from the paper's text, in both presets:

    - "Up" is the z axis of the world, which is the first sweep's; the paper takes the sensor's.
    - ``neighbors`` counts the front point itself, so it has ``k_nn - 1`` others.
    - The paper is silent where no point lies within ``seed_radius`` of a pose: the radius doubles
      until one does.
    - A seed's plane goes through the mean of its neighbours, not through the seed: the lowest point
      is often a ghost return below the road.
    - Of a LiDAR that stands (all poses within 2 m) the nearest voxels are often of one ring. Where
      they lie on a line that is too steep, eight times as many tell the plane.
    - Chunks overlap by 100 m of path; the paper is silent on their borders. Labels do not depend on
      ``chunk_length``, but memory does.
    - Path length leaves out steps shorter than 5 cm, which a standing sensor's jitter makes.

    The paper seeds with the lowest point and has no steps: ``seed_quantile=0``, ``step_height=0``.
    """

    chunk_length: float = Field(
        300.0, ge=10, le=5000, description="path length of a chunk that grows as a whole, l [m]"
    )
    voxel_size: float = Field(0.03, ge=0.01, le=1, description="edge of a voxel, s [m]")
    seed_radius: float = Field(
        2.0, ge=0.1, le=50, description="horizontal distance of seeds from a pose, r_seed [m]"
    )
    seed_quantile: float = Field(
        0.1,
        ge=0,
        le=0.9,
        description="height quantile of the voxels there that is the seed; 0: the lowest [-]",
    )
    step_height: float = Field(
        0.25, ge=0, le=2, description="highest kerb that ground continues behind; 0: none [m]"
    )
    neighbors: int = Field(
        30, ge=3, le=200, description="nearest voxels that define a plane, k_nn [-]"
    )
    plane_distance: float = Field(
        0.04, ge=0.001, le=1, description="largest distance of ground from that plane, delta [m]"
    )
    max_slope_deg: float = Field(
        15.0, ge=1, le=80, description="largest slope of that plane, alpha [deg]"
    )


class DynamicsParameters(_Stage):
    """Key frames (paper IV-B), their votes (IV-C, Algorithm 1), and classes from votes.

    Differences from the paper's text, in both presets:

    - Path length leaves out steps shorter than 5 cm, so a standing sensor adds no key frames.
    - The last pose of the path is a key frame, too.
    - A key frame never votes on its own sweep.

    The paper votes with range images, chooses key frames along the path alone, and classifies each
    point by its own votes: ``vote_model="range_image"``, ``time_spacing=0``, ``evidence="points"``.
    """

    vote_model: Literal["range_image", "surface"] = Field(
        "surface",
        description="key frames vote by the pixels of a range image (the paper), or by the surface "
        "that their returns span",
    )
    fine_spacing: float = Field(
        2.0, ge=0.1, le=1000, description="spacing of fine key frames, d_fine [m]"
    )
    fine_radius: float = Field(
        20.0,
        ge=0.1,
        le=1000,
        description="fine key frames vote this far along the path, R_fine [m]",
    )
    coarse_spacing: float = Field(
        5.0, ge=0.1, le=1000, description="spacing of coarse key frames, d_coarse [m]"
    )
    coarse_radius: float = Field(
        80.0,
        ge=0.1,
        le=1000,
        description="coarse key frames vote this far along the path, R_coarse [m]",
    )
    time_spacing: float = Field(
        0.5,
        ge=0,
        le=60,
        description="spacing of key frames in time where the ego is slow or stands; 0: none [s]",
    )
    resolution_deg: float = Field(
        0.2, ge=0.05, le=5, description="pixel of a key frame, d_theta = d_phi [deg]"
    )
    window: int = Field(5, ge=1, le=15, description="edge of the compared window, w [pixels]")
    tolerance: float = Field(
        0.2, ge=0.001, le=10, description="range difference of returns that are the same, tau [m]"
    )
    evidence: Literal["points", "objects", "tracks"] = Field(
        "tracks",
        description="points: each point by its own votes (the paper); objects: votes are shared "
        "within an object; tracks: and carried over time along tracked objects",
    )

    @field_validator("window")
    @classmethod
    def _odd(cls, window: int) -> int:
        if window % 2 == 0:
            raise ValueError("the window has a centre pixel, so its edge is odd")
        return window

    @model_validator(mode="after")
    def _some_key_frames(self) -> DynamicsParameters:
        check_key_frames("fine", self.fine_spacing, self.fine_radius)
        check_key_frames("coarse", self.coarse_spacing, self.coarse_radius)
        return self


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
        15.0, ge=0, le=1000, description="static points come from this path behind, d_min [m]"
    )
    ahead: float = Field(
        80.0, ge=0.01, le=1000, description="static points come from this path ahead, d_max [m]"
    )
    step: float = Field(
        0.25, ge=0.01, le=100, description="path between sweeps of static points, d_step [m]"
    )
    crop: float = Field(
        300.0, ge=1, le=2000, description="largest range of static points, d_crop [m]"
    )
    max_depth: float = Field(250.0, ge=1, le=2000, description="far plane of the depth map [m]")
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

    @field_validator("static_size", "dynamic_size")
    @classmethod
    def _falling(cls, size: tuple[float, float]) -> tuple[float, float]:
        if size[0] < size[1]:
            raise ValueError("the first number, sigma_max, must not be below the second, sigma_min")
        return size


class OutputParameters(_Stage):
    """The files of each depth map."""

    format: tuple[DepthFormat, ...] = Field(
        ("png",), min_length=1, description="file formats; PNG holds uint16, all others floats"
    )
    scale: float = Field(256.0, ge=1, le=10000, description="value of one metre in a PNG [1/m]")
    layers: tuple[Layer, ...] = Field((), description="further layers, written per pixel")

    @field_validator("format", "layers", mode="before")
    @classmethod
    def _listed(cls, names: Any) -> Any:
        names = names.split(",") if isinstance(names, str) else names
        every = isinstance(names, (list, tuple)) and all(isinstance(name, str) for name in names)
        return tuple(dict.fromkeys(names)) if every else names

    @field_validator("format")
    @classmethod
    def _one_exr(cls, format: tuple[str, ...]) -> tuple[str, ...]:
        if {"exr", "exr-half"} <= set(format):
            raise ValueError("exr and exr-half share one file name; choose one of them")
        return format


class Parameters(_Stage):
    """Parameters of all stages of a run. Unknown names are errors."""

    preset: Preset = "default"
    odometry: OdometryParameters = OdometryParameters()
    ground: GroundParameters = GroundParameters()
    dynamics: DynamicsParameters = DynamicsParameters()
    render: RenderParameters = RenderParameters()
    output: OutputParameters = OutputParameters()

    def __repr__(self) -> str:
        changes = departures(self)
        return f"parameters({self.preset!r}{f', {changes}' if changes else ''})"

    __str__ = __repr__


STAGES: dict[str, type[BaseModel]] = {
    stage: type(default) for stage, default in Parameters() if stage != "preset"
}

# What `paper` sets apart from `default`, stage by stage.
_PAPER: dict[str, dict[str, object]] = {
    "ground": {"chunk_length": 500, "seed_quantile": 0, "step_height": 0},
    "dynamics": {
        "vote_model": "range_image",
        "coarse_spacing": 10,
        "coarse_radius": 50,
        "time_spacing": 0,
        "evidence": "points",
    },
    "render": {"primitive": "splats", "behind": 0.5, "ahead": 100, "step": 0.2},
}


def parameters(preset: Preset = "default", settings: Settings | None = None) -> Parameters:
    """Parameters of a preset with single values replaced.

    Parameters
    ----------
    preset : {"default", "paper"}
        ``default`` is what measured best, ``paper`` follows the paper's text.
    settings : dict, optional
        Values by dotted name, ``{"dynamics.tolerance": 0.3}``.

    Raises
    ------
    ConfigError
        The preset or a name is unknown, or a value is outside its range.
    """
    if preset not in ("default", "paper"):
        raise ConfigError(f"unknown preset {preset!r}; there are 'default' and 'paper'")
    if settings is not None and not isinstance(settings, dict):
        raise ConfigError(
            f"settings must be a dict by dotted name, not {type(settings).__name__}: "
            '{"dynamics.tolerance": 0.3}'
        )
    changed = _PAPER if preset == "paper" else {}
    tree: dict[str, dict[str, object]] = {stage: {**values} for stage, values in changed.items()}
    for name, value in (settings or {}).items():
        stage, _, key = name.partition(".")
        if not key or stage not in STAGES:
            raise ConfigError(
                f"unknown parameter {name!r}; write stage.name with a stage of {', '.join(STAGES)}"
            )
        tree.setdefault(stage, {})[key] = value
    return stored_parameters({"preset": preset, **tree})


def checked_parameters(values: Parameters | None) -> Parameters:
    """The parameters that a function was given; the defaults for None."""
    if values is not None and not isinstance(values, Parameters):
        raise InputError(
            'parameters must be docdepth.parameters(...), such as docdepth.parameters("paper"), '
            f"not {type(values).__name__}"
        )
    return values or Parameters()


def replaced(values: Parameters, settings: Settings) -> Parameters:
    """Parameters with single values replaced, by dotted name."""
    if not settings:
        return values
    return parameters(values.preset, {**_by_name(values), **settings})


def departures(values: Parameters) -> dict[str, object]:
    """The values that differ from those of their preset, by dotted name."""
    preset = _by_name(parameters(values.preset))
    return {name: value for name, value in _by_name(values).items() if value != preset[name]}


def _by_name(values: Parameters) -> dict[str, object]:
    """All values by dotted name."""
    tree = values.model_dump(exclude={"preset"})
    return {f"{stage}.{name}": v for stage, named in tree.items() for name, v in named.items()}


def stored_parameters(tree: Any, file: Path | None = None) -> Parameters:
    """Parameters from a tree ``{stage: {name: value}}``, as ``run.yaml`` keeps it."""
    try:
        return Parameters.model_validate(tree)
    except ValidationError as error:
        raise ConfigError((f"{file}: " if file else "") + explain(error, STAGES)) from None
