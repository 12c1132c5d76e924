"""The verb that finds K and the place of a camera."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.table import Table

from docdepth.cli.options import DatasetName, Json, one_of, option, option_of, verb
from docdepth.cli.progress import progress_bars
from docdepth.cli.terminal import out, say, show_json
from docdepth.datasets import Dataset, ImageStream, image_streams, open_dataset
from docdepth.errors import CalibrationError, ConfigError
from docdepth.evaluation.camera_error import fit_calibration
from docdepth.evaluation.time_offset import image_times, time_offset
from docdepth.geometry.se3 import inverse
from docdepth.io.atomic import write_output
from docdepth.io.calibration import INTRINSICS, write_calibration
from docdepth.io.images import PICTURE, encode_image
from docdepth.io.inputs import RunInputs
from docdepth.io.run_folder import RunFolder

if TYPE_CHECKING:  # it needs an extra
    from docdepth.calibration.calibrate import Calibration


_Board = Annotated[
    str | None,
    option(
        "Outline of the board along the columns and along the rows, metres; the checkerboard "
        "is in its middle.",
        "WxH",
    ),
]
_Pattern = Annotated[
    str | None,
    option(
        "What is on the board: checkerboard (if absent), charuco, or circles in rows and columns. "
        "Of circles their centres are counted, and the side of a square is their distance.",
        **one_of(("checkerboard", "charuco", "circles")),
    ),
]
_Output = Annotated[
    Path | None,
    option(
        "Folder for the result, created.",
        "DIR",
        "-o --output",
    ),
]
_Time = Annotated[
    bool,
    option(
        "RECORDING is a run: estimate by how much the clocks of camera and LiDAR differ.",
        flags="--time",
    ),
]
_Lens = Annotated[
    str | None,
    option(
        "Estimate K and the distortion of such a lens: pinhole or fisheye. If absent, those of "
        "the recording are taken, or those of a pinhole estimated if it has none.",
        **one_of(("pinhole", "fisheye")),
    ),
]
_Boxes = Annotated[
    list[str] | None,
    option(
        "Least and greatest x, y and z of the board in the LiDAR frame, metres, of one image "
        "or of all: where a wall or a person is too near behind it.",
        "[IMAGE:]X,X,Y,Y,Z,Z",
    ),
]
_Recording = Annotated[
    Path,
    typer.Argument(
        metavar="RECORDING",
        help="A run, to fit its cameras to its images; or images and sweeps of a checkerboard in "
        "10 poses or more: a folder with docdepth.yaml, or a bag.",
    ),
]


@verb()
def calibrate(
    recording: _Recording,
    corners: Annotated[
        str | None, option("Inner corners of the checkerboard: columns, rows.", "CxR")
    ] = None,
    square: Annotated[float | None, option("Side of a square, metres.", "M")] = None,
    board: _Board = None,
    pattern: _Pattern = None,
    output: _Output = None,
    time: _Time = False,
    dataset: DatasetName = None,
    camera: Annotated[str | None, option("Camera; needed where there are several.", "NAME")] = None,
    frames: Annotated[str | None, option_of(RunInputs, "frames")] = None,
    lens: _Lens = None,
    box: _Boxes = None,
    as_json: Json = False,
) -> None:
    """Find where a camera sits: by the images of a run, or by a checkerboard.

    Of a run, each camera is turned and moved until depth edges lie on edges of its images. Of a
    checkerboard, K and the distortion are found, too. docdepth run --calibration takes calib.json;
    look at the pictures beside it first.

      docdepth calibrate RUN -o fitted
      docdepth calibrate RUN --time -o times
      docdepth calibrate boards/ --corners 5x7 --square 0.095 --board 0.61x0.85 -o calibration
    """
    of_boards = (corners, square, board, pattern, dataset, frames, lens, box)
    if time or (recording / "run.yaml").is_file():
        if any(one is not None for one in of_boards):
            raise ConfigError("a run takes --camera, --time, -o and --json; leave the others out")
        if time:
            return _compare_clocks(recording, camera, output, as_json)
        return _fit_cameras(recording, camera, output, as_json)
    if corners is None or square is None or board is None or output is None:
        raise ConfigError("a checkerboard needs --corners, --square, --board and -o")
    from docdepth.calibration.board import PATTERNS, parse_board
    from docdepth.calibration.calibrate import calibrate as calibrate_pairs
    from docdepth.calibration.lens import Lens
    from docdepth.calibration.pairs import board_pairs
    from docdepth.calibration.result import quality_of, write_result

    target = parse_board(corners, square, board, pattern or PATTERNS[0])
    boxes = _boxes(box)
    drive = open_dataset(recording, dataset, frames=frames)
    stream = _stream(drive, camera)
    if any(image.parent.resolve() == output.resolve() for image in stream.images):
        raise ConfigError(f"{output} holds the images of {stream.name}; choose another folder (-o)")
    known = None
    if stream.camera is not None and not lens:
        K, width, height = stream.camera.K, stream.camera.width, stream.camera.height
        distortion = np.zeros(5) if stream.distortion is None else stream.distortion
        known = Lens(stream.model, K, distortion, width, height)
    with progress_bars() as progress:
        pairs, size = board_pairs(drive, stream, target, boxes, progress)
        found = calibrate_pairs(target, pairs, size, known, lens or stream.model, progress)
        write_result(output, stream.name, target, pairs, found, progress)
    quality = quality_of(found)
    if as_json:
        return show_json(quality)
    return _show(found, quality, known is None, output)


def _compare_clocks(run: Path, camera: str | None, output: Path | None, as_json: bool) -> None:
    """Print by how much clocks of a run differ; write the times that the images should have."""
    with progress_bars() as progress:
        found = time_offset(run, camera, progress)
    lines = list(found.lines)
    if output is not None:
        times = found.corrected(image_times(run, camera)).encode()
        write_output(output / "camera_times.txt", times)
        name = output / "camera_times.txt"
        lines.append(f"with them: docdepth run RECORDING --camera-times {name} -o RUN")
    return show_json(found.figures) if as_json else say(*lines)


def _fit_cameras(run: Path, camera: str | None, output: Path | None, as_json: bool) -> None:
    """Print what images say of the cameras of a run; write pictures, and cameras that fit."""
    folder = RunFolder.open(run)
    names = [name for name, entry in folder.cameras.items() if entry.virtual is None]
    figures: dict[str, object] = {}
    for name in names if camera is None and names else [camera]:
        with progress_bars() as progress:
            found = fit_calibration(run, name, progress)
        stream = found.stream
        figures[stream.name] = found.figures
        lines = [f"{stream.name}:"] * (len(names) > 1) + found.lines
        if output is not None:
            place = output / stream.name if len(names) > 1 else output
            picture = place / f"{found.check.worst}.jpg"
            write_output(picture, encode_image(found.check.picture, ".jpg", *PICTURE))
            lines.append(f"{picture}: depth edges as they are red, where they fit green")
            if found.is_changed:
                more: dict[str, object] = {"fit": found.figures["fit"]}
                write_calibration(
                    place, stream.camera, stream.T_camera_lidar, stream.distortion_coefficients,
                    stream.model, write_output, more, stream.name,
                )  # fmt: skip
                file = place / INTRINSICS
                lines.append(f"with it: docdepth run RECORDING --calibration {file} -o RUN")
        if not as_json:
            say(*lines)
    if as_json:
        show_json(figures)


def _stream(recording: Dataset, name: str | None) -> ImageStream:
    """The camera to calibrate."""
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


def _boxes(texts: list[str] | None) -> dict[str, NDArray[np.float64]]:
    """Boxes by the names of images; "" for all."""
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


def _show(found: Calibration, quality: dict[str, Any], estimated: bool, output: Path) -> None:
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
    say(*lines)
