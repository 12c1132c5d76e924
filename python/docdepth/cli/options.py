"""Options that several verbs share, and what they mean together."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from docdepth.cli.names import (
    DATASETS,
    FORMATS,
    LAYERS,
    ON_ERROR,
    PRESETS,
    RENDERERS,
    one_of,
    some_of,
)
from docdepth.datasets import experimental_formats
from docdepth.io.manifest import KEPT

if TYPE_CHECKING:
    from docdepth.io.run_folder import RunFolder

RunPath = Annotated[
    Path, typer.Argument(metavar="RUN", help="Run folder, as docdepth run -o made it.")
]
Output = Annotated[
    Path | None,
    typer.Option(
        "-o", "--output", metavar="RUN", help="Run folder: created, or continued if it is there."
    ),
]
DatasetName = Annotated[
    str | None,
    typer.Option(
        "--dataset",
        help=f"Format of the recording: {', '.join(DATASETS)}; guessed if absent. "
        f"Experimental, never tried on a real recording: {', '.join(experimental_formats())}.",
        **one_of(DATASETS),
    ),
]
PresetName = Annotated[
    str,
    typer.Option(
        "--preset",
        help="Values that all parameters start from: default (most accurate) or "
        "paper (the paper's method).",
        **one_of(PRESETS),
    ),
]
ChosenPreset = Annotated[
    str | None,
    typer.Option(
        "--preset",
        help="Values that all parameters start from: default (most accurate, taken if absent) or "
        "paper (the paper's method).",
        **one_of(PRESETS),
    ),
]
ConfigFile = Annotated[
    Path | None,
    typer.Option(
        "--config",
        metavar="FILE",
        help="YAML file of parameters by stage (odometry: {max_range: 80}), or the run.yaml of a "
        "run, whose recording and camera are then taken too. Options win over the file.",
    ),
]
Frames = Annotated[
    str | None,
    typer.Option(
        "--frames",
        metavar="A:B",
        help="Take sweeps A to B-1 of the recording only, counted from 0; all if absent.",
    ),
]
PosesFile = Annotated[
    str | None,
    typer.Option(
        "--poses",
        metavar="FILE",
        help="Poses of the LiDAR from your own SLAM, one per sweep: TUM, KITTI, PLY or NPY. "
        "CAMERA:FILE for those of a camera, dataset for the recording's own; estimated if absent.",
    ),
]
CameraTimes = Annotated[
    Path | None,
    typer.Option(
        "--camera-times",
        metavar="FILE",
        help="Times of the images in seconds, one per line; those of the recording if absent.",
    ),
]
CalibrationFile = Annotated[
    Path | None,
    typer.Option(
        "--calibration",
        metavar="FILE",
        help="calib.json of docdepth calibrate, or a text file with the 4x4 matrix T_camera_lidar: "
        "taken in place of the recording's own calibration.",
    ),
]
GivenLabels = Annotated[
    Path | None,
    typer.Option(
        "--labels",
        metavar="DIR",
        help="Draw with the classes of another method: a folder of NAME.label (SemanticKITTI), "
        "NAME.npy (classid) or NAME.pcd for each sweep, or a run. Nothing is classified then.",
    ),
]
ImageSize = Annotated[
    str | None,
    typer.Option(
        "--image-size",
        metavar="WxH",
        help="Size of the images in pixels, for a recording without images that does not tell "
        "it, for example 1242x375.",
    ),
]
OnError = Annotated[
    str | None,
    typer.Option(
        "--on-error",
        help="What to do about broken sweeps and images. stop: name them and end. skip: read all "
        "before the run begins and leave out broken ones. As the run began if absent, else stop.",
        **one_of(ON_ERROR),
    ),
]
Keep = Annotated[
    str | None,
    typer.Option(
        "--keep",
        help="What stays once all is done. results: all but the frames, which are four fifths of "
        "the bytes; view, map and render need them. frames: these as well; they are made again if "
        "they were deleted. As the run began if absent, else frames.",
        **one_of(KEPT),
    ),
]
HashInputs = Annotated[
    bool,
    typer.Option(
        "--hash-inputs",
        help="Tell by their content whether sweeps and images have changed, not by size and time; "
        "reads the whole recording once.",
    ),
]
Force = Annotated[
    bool,
    typer.Option(
        "--force",
        help="Continue a run that was started with other inputs or parameters; what they change "
        "is made again.",
    ),
]
DryRun = Annotated[
    bool,
    typer.Option("--dry-run", help="Check all inputs and tell what would be made; make nothing."),
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="STAGE.NAME=VALUE",
        help="Set one parameter, for example dynamics.tolerance=0.3; repeat it for more. "
        "docdepth parameters lists all.",
    ),
]
Threads = Annotated[
    int,
    typer.Option(
        min=0, max=256, metavar="N", help="Threads to use; 0 takes every core. Same result."
    ),
]
Jobs = Annotated[
    int,
    typer.Option(
        min=1,
        max=1024,
        metavar="N",
        help="Processes of this machine that share the work after odometry. Same result.",
    ),
]
Memory = Annotated[
    str | None,
    typer.Option(
        metavar="SIZE",
        help="Most memory of all processes together, for example 4G: ground grows in chunks short "
        "enough, or the run says before it starts what it would need. Same result.",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Dask scheduler (tcp://HOST:8786) whose workers share the work instead. They must see "
        "recording and run folder under the same paths.",
    ),
]
AllBelow = Annotated[
    Path | None,
    typer.Option(
        "--all",
        metavar="ROOT",
        help="Run every recording below this folder, the longest first, each into a folder of its "
        "own below -o. One that fails does not stop the others.",
    ),
]
RendererName = Annotated[
    str,
    typer.Option(
        "--renderer",
        help=f"What draws: {', '.join(RENDERERS)}; all draw the same.",
        **one_of(RENDERERS),
    ),
]
CameraNames = Annotated[
    list[str] | None,
    typer.Option(
        "--camera",
        metavar="NAME[,NAME...]",
        help="Cameras to draw, as the recording names them (image_02), all, or none for poses and "
        "labels alone; the left colour camera if absent.",
    ),
]
OneCamera = Annotated[
    str | None,
    typer.Option("--camera", metavar="NAME", help="Camera; needed where the run has several."),
]
Formats = Annotated[
    list[str] | None,
    typer.Option(
        "--format",
        help=f"Files of each depth map: {', '.join(FORMATS)}; png if absent.",
        **some_of(FORMATS),
    ),
]
Scale = Annotated[
    float | None,
    typer.Option(
        metavar="X",
        help="PNG value of one metre: 256 as KITTI if absent, up to 255 m; 64 reaches 1023 m.",
    ),
]
LayerNames = Annotated[
    list[str] | None,
    typer.Option(
        "--layers",
        help=f"Further arrays per pixel, written beside the depth: {', '.join(LAYERS)}; none if "
        "absent.",
        **some_of(LAYERS),
    ),
]
VirtualPose = Annotated[
    str | None,
    typer.Option(
        "--pose",
        metavar="POSE",
        help="Draw for a virtual camera at this pose in the LiDAR frame (x forward, y left, "
        "z up): x,y,z looks ahead; x,y,z,qx,qy,qz,qw; or a file with a 4x4 matrix.",
    ),
]
VirtualIntrinsics = Annotated[
    str | None,
    typer.Option(
        "--K",
        metavar="FX,FY,CX,CY",
        help="Intrinsics of the virtual camera: focal lengths and principal point in pixels, "
        "for example 700,700,640,360.",
    ),
]
VirtualSize = Annotated[
    str | None,
    typer.Option(
        "--size",
        metavar="WxH",
        help="Image size of the virtual camera in pixels, for example 1280x720.",
    ),
]
VirtualName = Annotated[
    str | None,
    typer.Option(
        "--name",
        metavar="NAME",
        help="Name of the virtual camera: maps go to depth/NAME; virtual if absent.",
    ),
]
VirtualTimes = Annotated[
    Path | None,
    typer.Option(
        "--camera-times",
        metavar="FILE",
        help="Times of the virtual camera's images in seconds, one per line; those of the "
        "sweeps if absent.",
    ),
]
Json = Annotated[
    bool, typer.Option("--json", help="Print the result as JSON; messages go to standard error.")
]


def listed(names: list[str] | None) -> str | list[str] | None:
    """Names from repeated options or commas; a single name as a string."""
    from docdepth.errors import ConfigError

    every = [name.strip() for text in names or [] for name in text.split(",")]
    if "" in every:
        raise ConfigError("--camera holds an empty name; write NAME or NAME,NAME")
    return every[0] if len(every) == 1 else every or None


def changes_of(settings: list[str] | None) -> dict[str, Any]:
    from docdepth.config import parse_settings

    return parse_settings(settings or [])


def output_of(
    format: list[str] | None, scale: float | None, layers: list[str] | None
) -> dict[str, Any]:
    """Parameters that have an option of their own."""
    chosen: dict[str, Any] = {}
    if format:
        chosen["output.format"] = ",".join(format)
    if scale is not None:
        chosen["output.scale"] = scale
    if layers:
        chosen["output.layers"] = ",".join(layers)
    return chosen


def reopen(path: Path, changes: dict[str, Any], *stages: str) -> RunFolder:
    """A run with some parameters of one stage replaced; kept in run.yaml once a stage uses them."""
    from docdepth.config import replaced
    from docdepth.io.run_folder import RunFolder

    check_stages(changes, *stages)
    folder = RunFolder.open(path)
    values = replaced(folder.parameters, changes)
    folder.manifest["parameters"] = values.model_dump(mode="json")
    return folder


def check_stages(changes: dict[str, Any], *stages: str) -> None:
    """Refuse parameters of other stages."""
    from docdepth.errors import ConfigError

    for name in changes:
        if name.partition(".")[0] not in stages:
            raise ConfigError(f"--set {name}: this stage knows {' and '.join(stages)} only")
