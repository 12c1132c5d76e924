"""``run.yaml``: inputs, parameters, cameras and the profile of each stage."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from docdepth._core import __version__
from docdepth.config import Parameters, stored_parameters
from docdepth.errors import ConfigError, RunError
from docdepth.io.file_records import is_file_name
from docdepth.io.inputs import Checked, DerivedInputs, RunInputs
from docdepth.io.untrusted import parse_yaml, read_text

Keep = Literal["frames", "results"]
"""Whether the frames stay once all is done, or only the results."""


def _inside_depth(folder: str) -> str:
    if folder and not is_file_name(folder):
        raise ValueError("it is no folder in depth/")
    return folder


class VirtualCamera(Checked):
    """A camera that moves with the LiDAR."""

    T_lidar_camera: tuple[tuple[float, float, float, float], ...]
    K: tuple[tuple[float, float, float], ...]
    size: tuple[int, int]  # width and height in pixels
    times: Path | None = None  # file with the time of each image; the times of the sweeps if absent


class StoredCameraFit(Checked):
    """What the images of a camera ask for."""

    made_of: str  # hash of the classes, and of calibration and times as they were given
    verdict: str = ""  # in words; empty where the images cannot tell, or nothing is to be changed
    applied: bool = False  # whether the run takes it
    # turn_deg, shift_m: of points about and along the camera's axes x, y, z
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    time_ms: float = 0.0  # what is added to the times of the images


class CameraEntry(Checked):
    """A camera of a run."""

    # where its maps lie in ``depth/``; empty for ``depth/`` itself
    folder: Annotated[str, AfterValidator(_inside_depth)]
    # parameters of this camera alone, by dotted name
    settings: dict[str, object] = Field(default_factory=dict)
    virtual: VirtualCamera | None = None  # None for a camera of the recording
    fit: StoredCameraFit | None = None  # None before a run looked for it


class StageEntry(Checked):
    """State and profile of a stage."""

    state: Literal["running", "done"] = "running"
    key: str | None = None  # hash of what its results are made of; None before it begins
    all_frames: int = 0  # sweeps or images of the stage
    # frames, wall_seconds, seconds: what the last command worked on, how long, and the seconds of
    # each step
    frames: int = 0
    wall_seconds: float = 0.0
    seconds: dict[str, float] = Field(default_factory=dict)
    # total_frames, total_seconds, peak_memory_mb: of all commands together
    total_frames: int = 0
    total_seconds: float = 0.0
    peak_memory_mb: int = 0
    # warnings, left_out: left out are images outside the sweeps
    warnings: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    # renderer, density, calibration: who drew, the mean share of pixels with depth, and what images
    # say of the calibration
    renderer: str | None = None
    density: float | None = None
    calibration: str | None = None
    # labels, tracks: the folder of classes of another method, and whether its tracks are used
    labels: str | None = None
    tracks: bool | None = None


class RunManifest(BaseModel):
    """The content of run.yaml."""

    model_config = ConfigDict(extra="forbid")

    docdepth: str = __version__  # version that started the run
    inputs: RunInputs | None = None  # None where the folder was not made of a recording
    derived: DerivedInputs = DerivedInputs()
    parameters: Parameters = Parameters()
    parameters_at_start: Parameters | None = None  # before a stage changed some
    cameras: dict[str, CameraEntry] = {}
    keep: Keep | None = None  # which files to keep when the run is complete; ``frames`` if absent
    # keys of the stages whose frames were deleted; frames count as present while these match
    frames_deleted: dict[str, str | None] | None = None
    # length of chunks of ground that keep to a budget of memory [m]
    chunk_length: float | None = None
    # warnings, estimate: what the checks of the inputs have found
    warnings: list[str] = []
    estimate: str = ""
    # folders that docdepth has written into; None if it did not make this folder
    folders_written: list[str] | None = None
    trial: str | None = None  # of ``tune``: hash of what the trial is made of
    stages: dict[str, StageEntry] = {}

    def continue_with(
        self,
        path: Path,
        inputs: RunInputs | None,
        derived: DerivedInputs,
        parameters: Parameters,
        force: bool,
    ) -> None:
        """Take what the run in folder ``path`` is given now."""
        first, comparable = self.parameters_at_start or self.parameters, inputs
        if inputs is not None and self.inputs is not None:
            # Another camera is added to those that the run has.
            inputs = inputs.but(camera=self.inputs.camera)
            comparable = inputs.but(on_error=self.inputs.on_error)
        found = self.derived.model_copy(update={"skipped": derived.skipped})
        for have, want in (self.inputs, comparable), (found, derived), (first, parameters):
            is_known = want is parameters and parameters == self.parameters
            if have != want and not force and not is_known:
                difference = _first_difference(_tree(have), _tree(want))
                raise RunError(
                    f"{path} holds another run: its {difference}",
                    "name another folder by `output`, or go on here with new values by "
                    "`force=True`",
                )
        self.inputs, self.derived = inputs, derived
        if parameters != first or self.parameters_at_start is None:
            self.parameters = parameters
        self.parameters_at_start = parameters

    def text(self) -> bytes:
        """As run.yaml holds it."""
        tree = self.model_dump(mode="json", exclude_none=True)
        try:
            return yaml.dump(tree, Dumper=yaml.CSafeDumper, sort_keys=False).encode()
        except UnicodeEncodeError:  # libyaml takes no path whose bytes are no text
            return yaml.dump(tree, Dumper=yaml.SafeDumper, sort_keys=False).encode()


def read_manifest(path: Path) -> RunManifest | None:
    """The content of run.yaml; None if it is missing or damaged. A refused parameter raises."""
    try:
        tree = parse_yaml(read_text(path))
    except (OSError, ValueError):
        return None
    if not isinstance(tree, dict) or not {"parameters", "stages"} <= tree.keys():
        return None
    try:
        found = RunManifest.model_validate({**tree, "parameters": {}, "parameters_at_start": None})
    except (ValidationError, ConfigError):
        return None
    found.parameters = stored_parameters(tree["parameters"], path)
    if "parameters_at_start" in tree:
        found.parameters_at_start = stored_parameters(tree["parameters_at_start"], path)
    return found


def _tree(model: BaseModel | None) -> dict[str, Any]:
    return (model or RunManifest()).model_dump(mode="json")


def _first_difference(have: Any, want: Any, path: str = "") -> str:
    if isinstance(have, dict) and isinstance(want, dict):
        for key in {**have, **want}:
            if have.get(key) != want.get(key):
                inner = f"{path}.{key}" if path else key
                return _first_difference(have.get(key), want.get(key), inner)
    if want is None:
        return f"{path} is {have!r}, and now it is not given"
    return f"{path} is {'not given' if have is None else repr(have)}, not {want!r}"
