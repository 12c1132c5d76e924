"""The whole calibration: images and sweeps of a checkerboard to K and ``T_camera_lidar``."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from docdepth.calibration.board import Board
from docdepth.calibration.bundle import Observation, Solution, residuals, solve_bundle
from docdepth.calibration.corners import board_pose
from docdepth.calibration.find import FEWEST_BOARDS, SeenBoard, check_varied, find_boards
from docdepth.calibration.lens import MODELS, Lens, estimate_lens
from docdepth.calibration.quality import (
    Halves,
    LeftOutBoard,
    check_size,
    halves,
    leave_one_out,
    uncertainty,
)
from docdepth.calibration.sweeps import BoardSweep
from docdepth.concurrency import Progress, null_progress
from docdepth.datasets.files import ImageSource
from docdepth.errors import CalibrationError, Finding, log_findings
from docdepth.geometry.se3 import inverse

log = logging.getLogger(__name__)

Floats = NDArray[np.float64]

_DISAGREES = 0.03  # metres at the corners of the outline; less may be noise
_TIMES_MEDIAN = 4.0  # a board that disagrees by so many times what is usual is left out
_MOST_DISAGREE = 1 / 3  # of the boards; if more disagree, nothing tells which are right
_MISFIT = 1.0  # pixels RMS; corners that miss by more, and by _TIMES_MEDIAN, tell of the lens
_MOST_PIXELS = 3.0  # RMS of the corners of one image; above, they are not of the board


@dataclass(frozen=True)
class BoardPair:
    """An image and a sweep of a still board."""

    name: str
    corners: Floats | None  # (n, 2): pixels of the inner corners; None where they were not found
    sweep: BoardSweep
    image: ImageSource | None = None


@dataclass(frozen=True)
class Calibration:
    """Camera, extrinsic, and what they are worth."""

    observations: list[Observation]  # the boards that were used
    solution: Solution
    # what each board leaves: RMS of its corners [px], and of its returns from the plane [m]
    residuals: list[tuple[float, float]]
    boards: list[LeftOutBoard]  # what the others say about each board
    halves: Halves | None  # None for too few boards
    # turn_deg, shift_cm: (3,): standard deviations about the camera's axes
    turn_deg: Floats
    shift_cm: Floats
    not_used: dict[str, str]  # pairs that were not used, and why
    findings: tuple[Finding, ...] = ()  # what looks wrong; each is logged as well

    @property
    def lens(self) -> Lens:
        return self.solution.lens

    @property
    def T_camera_lidar(self) -> Floats:
        """Shape (4, 4)."""
        return self.solution.T_camera_lidar


def calibrate(
    board: Board,
    pairs: Sequence[BoardPair],
    size: tuple[int, int],
    lens: Lens | None = None,
    model: str = "pinhole",
    progress: Progress = null_progress,
) -> Calibration:
    """Calibrate a camera and a LiDAR.

    Parameters
    ----------
    size : (int, int)
        Width and height of the images in pixels.
    lens : Lens, optional
        Estimated from the same images if left out.
    model : {"pinhole", "fisheye"}
        Of the lens, if it is estimated.
    """
    observations, start, not_used = find(board, pairs, size, lens, model, progress)
    count, free_lens = len(observations), lens is None
    while True:
        solution = solve_bundle(board, observations, start, free_lens)
        boards = leave_one_out(board, observations, solution, free_lens, progress)
        bad = _that_disagree(boards)
        if not bad:
            break
        not_used |= bad
        kept = [k for k, o in enumerate(observations) if o.name not in bad]
        observations = [observations[k] for k in kept]
        start = replace(start.of(kept), T_camera_lidar=solution.T_camera_lidar)
        if len(kept) < FEWEST_BOARDS or count - len(kept) > _MOST_DISAGREE * count:
            raise CalibrationError(
                f"the boards disagree with each other, and leaving out {count - len(kept)} does "
                "not help: " + "; ".join(f"{name}: {reason}" for name, reason in not_used.items()),
                code="boards-disagree",
            )
        check_varied(start.T_camera_board[:, :3, 2], "that agree")
    turn, shift = uncertainty(boards)
    errors = residuals(board, observations, solution)
    findings = check_lens([o.name for o in observations], errors, solution.lens, free_lens)
    log_findings(log, findings)
    return Calibration(
        observations,
        solution,
        errors,
        boards,
        halves(board, observations, solution, free_lens, progress),
        turn,
        shift,
        not_used,
        tuple(findings),
    )


def find(
    board: Board,
    pairs: Sequence[BoardPair],
    size: tuple[int, int],
    lens: Lens | None = None,
    model: str = "pinhole",
    progress: Progress = null_progress,
) -> tuple[list[Observation], Solution, dict[str, str]]:
    """Find all boards; the parameters are those of :func:`calibrate`.

    Returns
    -------
    observations : list of Observation
    start : Solution
        K of the images alone and the extrinsic of planes alone, for the bundle.
    not_used : dict of str to str
        Pairs that were not used, and why.
    """
    not_used = {
        pair.name: f"no whole checkerboard of {board.columns}x{board.rows} inner corners in the "
        "image: it is partly out of the picture, blurred or hidden"
        for pair in pairs
        if pair.corners is None
    }
    in_image = [(pair, pair.corners) for pair in pairs if pair.corners is not None]
    if len(in_image) < FEWEST_BOARDS:
        names = f": not in {', '.join(not_used)}" if not_used else ""
        raise CalibrationError(
            f"too few boards: the checkerboard was found in {len(in_image)} of {len(pairs)} "
            f"images, at least {FEWEST_BOARDS} are needed, 10 or more are better; circles and "
            f"markers are not found{names}",
            code="few-boards",
        )
    if lens is not None and (lens.width, lens.height) != size:
        raise CalibrationError(
            f"K is of images of {lens.width}x{lens.height} pixels, these have {size[0]}x{size[1]}; "
            "say K of this size, or have it estimated (`model`)",
            code="size-of-images",
        )
    known = lens or estimate_lens(board, [corners for _, corners in in_image], size, model)[0]
    seen, misfits = _seen_boards(board, in_image, known)
    not_used |= misfits
    check_varied(np.stack([s.T_camera_board[:3, 2] for s in seen]), "in the images")
    observations, T_lidar_camera, missing = find_boards(board, seen, progress)
    check_size(board, observations, T_lidar_camera)
    poses = np.stack([o.T_camera_board for o in observations])
    return observations, Solution(inverse(T_lidar_camera), poses, known), not_used | missing


def _seen_boards(
    board: Board, in_image: Sequence[tuple[BoardPair, Floats]], lens: Lens
) -> tuple[list[SeenBoard], dict[str, str]]:
    """The boards whose corners fit the lens, and why others are left out, by name."""
    seen: list[SeenBoard] = []
    misfits: dict[str, str] = {}
    for pair, corners in in_image:
        pose, error = board_pose(corners, board, lens)
        if error > _MOST_PIXELS:
            misfits[pair.name] = (
                f"its corners miss the checkerboard by {error:.1f} px (RMS): another board, or the "
                "wrong K"
            )
        else:
            seen.append(SeenBoard(pair.name, corners, pose, pair.sweep))
    if len(seen) < FEWEST_BOARDS:
        raise CalibrationError(
            f"the corners of {len(misfits)} of {len(in_image)} images do not fit a "
            f"checkerboard seen through this lens (more than {_MOST_PIXELS:.0f} px): K, the lens "
            "model or the number of corners is wrong",
            code="corners-misfit",
        )
    return seen, misfits


def _that_disagree(boards: Sequence[LeftOutBoard]) -> dict[str, str]:
    """Why boards are left out that lie far from where the others put them.

    A bad board moves the extrinsic of all others, so only the worst ones are told at once.
    """
    usual = float(np.median([one.metres for one in boards]))
    worst = max(one.metres for one in boards)
    limit = max(_DISAGREES, _TIMES_MEDIAN * usual, 0.5 * worst)
    return {
        one.name: f"LiDAR and camera disagree by {100 * one.metres:.0f} cm about its place, usual "
        f"are {100 * usual:.1f} cm; did it move between image and sweep?"
        for one in boards
        if one.metres > limit
    }


def check_lens(
    names: Sequence[str], errors: Sequence[tuple[float, float]], lens: Lens, estimated: bool
) -> list[Finding]:
    """Whether a lens that fits most corners, but not those near the border, is of another kind."""
    pixels = np.array([error for error, _ in errors])
    worst, usual = int(np.argmax(pixels)), float(np.median(pixels))
    if pixels[worst] <= max(_MISFIT, _TIMES_MEDIAN * usual):
        return []
    missed = (
        f"the corners of {names[worst]} miss by {pixels[worst]:.1f} px, usual are {usual:.1f} px"
    )
    if estimated:
        other = next(model for model in MODELS if model != lens.model)
        text = f"{missed}: a {lens.model} lens does not take them so"
        return [Finding("another-lens", "", text, f"try `model={other!r}`")]
    text = f"{missed}: K and distortion do not hold there"
    return [Finding("lens-misfit", "", text, "have them estimated (`model`)")]
