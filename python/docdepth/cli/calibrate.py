"""The verb that finds K and the place of a camera."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from docdepth.cli.names import one_of
from docdepth.cli.options import DatasetName, Frames, Json
from docdepth.cli.progress import progress_bars
from docdepth.cli.summary import show_json
from docdepth.cli.terminal import app, out, verb

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from docdepth.calibration.calibrate import Calibration
    from docdepth.calibration.lens import Lens
    from docdepth.datasets import Dataset, ImageStream

LENSES = ("pinhole", "fisheye")


BoardRecording = Annotated[
    Path,
    typer.Argument(
        metavar="RECORDING",
        help="Images and sweeps of a checkerboard in 10 poses or more: a folder with "
        "docdepth.yaml, or a bag. With --check and --time a run.",
    ),
]
Corners = Annotated[
    str | None,
    typer.Option(metavar="CxR", help="Inner corners of the checkerboard: columns, rows."),
]
Square = Annotated[float | None, typer.Option(metavar="M", help="Side of a square, metres.")]
Outline = Annotated[
    str | None,
    typer.Option(
        metavar="WxH",
        help="Outline of the board along the columns and along the rows, metres; the checkerboard "
        "is in its middle.",
    ),
]
ResultFolder = Annotated[
    Path | None,
    typer.Option(
        "-o",
        "--output",
        metavar="DIR",
        help="Folder for the result, created; with --check for a picture, with "
        "--time for the times.",
    ),
]
Check = Annotated[
    bool,
    typer.Option(
        "--check",
        help="RECORDING is a run: tell whether depth edges lie on edges of its images, and by how "
        "much the calibration is off.",
    ),
]
OneOfSeveral = Annotated[
    str | None,
    typer.Option("--camera", metavar="NAME", help="Camera; needed where there are several."),
]
LensName = Annotated[
    str | None,
    typer.Option(
        "--lens",
        help="Estimate K and the distortion of such a lens: pinhole or fisheye. If absent, those "
        "of the recording are taken, or those of a pinhole estimated if it has none.",
        **one_of(LENSES),
    ),
]
Boxes = Annotated[
    list[str] | None,
    typer.Option(
        "--box",
        metavar="[IMAGE:]X,X,Y,Y,Z,Z",
        help="Least and greatest x, y and z of the board in the LiDAR frame, metres, of one image "
        "or of all: where a wall or a person is too near behind it.",
    ),
]
Time = Annotated[
    bool,
    typer.Option(
        "--time",
        help="RECORDING is a run: estimate by how much the clocks of camera and LiDAR differ.",
    ),
]


@verb(app)
def calibrate(
    recording: BoardRecording,
    corners: Corners = None,
    square: Square = None,
    board: Outline = None,
    output: ResultFolder = None,
    check: Check = False,
    time: Time = False,
    dataset: DatasetName = None,
    camera: OneOfSeveral = None,
    frames: Frames = None,
    lens: LensName = None,
    box: Boxes = None,
    as_json: Json = False,
) -> None:
    """Find K, the distortion and the place of a camera from a checkerboard.

    The board is found in the images and in the whole sweeps. docdepth run --calibration takes
    calib.json; look at the pictures beside it first.

      docdepth calibrate boards/ --corners 5x7 --square 0.095 --board 0.61x0.85 -o calibration
      docdepth calibrate --check RUN
      docdepth calibrate --time RUN -o times
    """
    from docdepth.errors import ConfigError

    if check or time:
        of_boards = (corners, square, board, dataset, frames, lens, box)
        if (check and time) or any(one is not None for one in of_boards):
            raise ConfigError(
                "--check and --time take a run, --camera, -o and --json; leave the others out"
            )
        of_run = _check_run if check else _compare_clocks
        return of_run(recording, camera, output, as_json)
    if corners is None or square is None or board is None or output is None:
        raise ConfigError(
            "a checkerboard needs --corners, --square, --board and -o; to check a run say --check"
        )
    from docdepth.calibration.board import parse_board
    from docdepth.calibration.calibrate import calibrate as calibrate_pairs
    from docdepth.calibration.pairs import board_pairs
    from docdepth.calibration.result import quality_of, write_result
    from docdepth.datasets import open_dataset

    target, boxes = parse_board(corners, square, board), _boxes(box)
    drive = open_dataset(recording, dataset, frames=frames)
    stream = _stream(drive, camera)
    _check_output(output, stream)
    known = None if lens else _lens_of(stream)
    model = lens or stream.model
    with progress_bars() as progress:
        pairs, size = board_pairs(drive, stream, target, boxes, progress)
        found = calibrate_pairs(target, pairs, size, known, model, progress)
        write_result(output, stream.name, target, pairs, found, progress)
    if as_json:
        return show_json(quality_of(found))
    _show(found, known is None, output)


def _check_run(run: Path, camera: str | None, output: Path | None, as_json: bool) -> None:
    """Print what depth edges say about the calibration of a run."""
    from docdepth.evaluation.camera_error import check_calibration
    from docdepth.pipeline.depth_files import encode_image

    with progress_bars() as progress:
        found = check_calibration(run, camera, progress)
    lines = found.lines
    if output is not None:
        path = _write(output / f"{found.worst}.jpg", encode_image(found.picture, ".jpg"))
        lines.append(f"{path}: depth edges as they are red, where they fit green")
    _print(lines, found.figures, as_json)


def _compare_clocks(run: Path, camera: str | None, output: Path | None, as_json: bool) -> None:
    """Print the offset of the clocks of a run, and write times with it."""
    from docdepth.evaluation.time_offset import image_times, time_offset

    with progress_bars() as progress:
        found = time_offset(run, camera, progress)
    lines = found.lines
    if output is not None:
        times = found.corrected(image_times(run, camera))
        path = _write(output / "camera_times.txt", times.encode())
        lines.append(f"with them: docdepth run RECORDING --camera-times {path} -o RUN")
    _print(lines, found.figures, as_json)


def _write(path: Path, content: bytes) -> Path:
    from docdepth.io.atomic import write_atomically

    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, lambda stream: stream.write(content))
    return path


def _print(lines: list[str], figures: dict[str, Any], as_json: bool) -> None:
    if as_json:
        return show_json(figures)
    for line in lines:
        out.print(line, soft_wrap=True, markup=False)


def _stream(recording: Dataset, name: str | None) -> ImageStream:
    """The camera to calibrate."""
    from docdepth.datasets import image_streams
    from docdepth.errors import CalibrationError

    streams = image_streams(recording)
    if not streams:
        raise CalibrationError(
            f"{recording.path} has no images; for a folder say cameras: {{front: {{images: DIR, "
            "times: sweeps}} in docdepth.yaml"
        )
    if name is None and len(streams) == 1:
        return next(iter(streams.values()))
    if name not in streams:
        missing = f"no images of {name}" if name else f"images of {len(streams)} cameras"
        raise CalibrationError(
            f"{recording.path} has {missing}; name one of {', '.join(streams)} (--camera)"
        )
    return streams[name]


def _check_output(output: Path, stream: ImageStream) -> None:
    """Pictures must not replace images: they have their names."""
    from docdepth.errors import ConfigError

    if any(image.parent.resolve() == output.resolve() for image in stream.images):
        raise ConfigError(f"{output} holds the images of {stream.name}; choose another folder (-o)")


def _lens_of(stream: ImageStream) -> Lens | None:
    """K and distortion of the recording, if it has them."""
    import numpy as np

    from docdepth.calibration.lens import Lens

    if stream.camera is None:
        return None
    distortion = np.zeros(5) if stream.distortion is None else stream.distortion
    camera = stream.camera
    return Lens(stream.model, camera.K, distortion, camera.width, camera.height)


def _boxes(texts: list[str] | None) -> dict[str, NDArray[np.float64]]:
    """Boxes by the names of images; "" for all."""
    import numpy as np

    from docdepth.errors import ConfigError

    boxes = {}
    for text in texts or []:
        name, _, numbers = text.rpartition(":")
        try:
            box = np.array([float(number) for number in numbers.split(",")]).reshape(3, 2)
        except ValueError:
            box = np.zeros((3, 2))
        if not (box[:, 0] < box[:, 1]).all():
            raise ConfigError(
                f"--box {text!r} must be x,x,y,y,z,z, least and greatest of each, in metres, for "
                "example 2.5,4,-1,1,-1.5,1; or with an image's name before it, pose3:2.5,4,..."
            )
        boxes[name] = box
    return boxes


def _show(found: Calibration, estimated: bool, output: Path) -> None:
    from docdepth.calibration.result import quality_of
    from docdepth.geometry.se3 import inverse

    quality = quality_of(found)
    table = Table("board", "corners px", "plane cm", "left out px", "left out cm", box=None)
    for name, one in quality["boards"].items():
        cells = (one[key] for key in ("corners_px", "plane_cm", "left_out_px", "left_out_cm"))
        table.add_row(name, *(f"{cell:.2f}" for cell in cells))
    out.print(table)
    lines = [f"not used: {name}: {why}" for name, why in quality["not_used"].items()]
    K, numbers = found.lens.K, " ".join(f"{k:.4f}" for k in found.lens.distortion)
    lines.append(
        f"{found.lens.model}, K {'estimated' if estimated else 'given'}: fx {K[0, 0]:.1f} fy "
        f"{K[1, 1]:.1f} cx {K[0, 2]:.1f} cy {K[1, 2]:.1f}, distortion {numbers}"
    )
    place = " ".join(f"{x:.3f}" for x in inverse(found.T_camera_lidar)[:3, 3])
    turn, shift = max(quality["uncertainty_deg"]), max(quality["uncertainty_cm"])
    lines.append(
        f"the camera is at {place} m in the LiDAR frame; one standard deviation is {turn:.2f} "
        f"degrees, {shift:.1f} cm"
    )
    lines.append(
        f"each board by the calibration of the others: off by {quality['left_out_px']:.1f} px in "
        "the median"
    )
    if found.halves is not None:
        degrees, centimetres = quality["halves_deg"], quality["halves_cm"]
        lines.append(
            f"halves without a common board differ by {degrees['median']:.2f} degrees and "
            f"{centimetres['median']:.1f} cm in the median, by at most {degrees['most']:.2f} and "
            f"{centimetres['most']:.1f}"
        )
    lines.append(f"look at the pictures in {output}, then: docdepth run RECORDING --calibration "
                 f"{output / 'calib.json'} -o RUN")  # fmt: skip
    for line in lines:
        out.print(line, soft_wrap=True, markup=False)
