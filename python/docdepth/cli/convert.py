"""The verb that writes poses, labels, depth and posed images for other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from docdepth.cli.options import DatasetName, one_of, option, verb
from docdepth.cli.progress import progress_bars
from docdepth.cli.terminal import say, volume
from docdepth.errors import ConfigError
from docdepth.export import EXPORTS, export
from docdepth.io.labels import LABEL_FORMATS
from docdepth.io.poses import POSE_FORMATS
from docdepth.pipeline import convert as converting
from docdepth.pipeline.convert import DEPTH_FORMATS


@verb()
def convert(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="IN", help="A run folder, a recording with poses or labels, or a pose file."
        ),
    ],
    output: Annotated[
        Path,
        typer.Argument(
            metavar="OUT",
            help="New file of poses, new folder of labels, photos or voxels, or folder of depth.",
        ),
    ],
    to: Annotated[
        str,
        option(
            f"Poses: {', '.join(POSE_FORMATS)}. Labels: label (SemanticKITTI), classid (NPY), "
            "pcd (as DynamicMap_Benchmark, the class as intensity). Depth: proj_depth (as KITTI "
            "releases it, OUT/DRIVE/proj_depth/groundtruth/CAMERA). Photos, poses, depth, masks of "
            "what moves and the static map: nerfstudio, colmap. All of a run as a ROS 2 bag: mcap. "
            "Voxels around the vehicle, as Occ3D has them: occupancy. The static map in the "
            "colours of the photos, PLY and LAZ: map.",
            **one_of((*POSE_FORMATS, *LABEL_FORMATS, *DEPTH_FORMATS, *EXPORTS)),
        ),
    ],
    dataset: DatasetName = None,
    camera: Annotated[
        str | None,
        option(
            "Write the poses of this camera, as KITTI has them; of the LiDAR if absent.", "NAME"
        ),
    ] = None,
) -> None:
    """Write poses, labels, depth or images of a run or a recording in the format of other tools.

    docdepth convert RUN poses.txt --to tum
    docdepth convert RUN labels --to classid
    docdepth convert RUN release --to proj_depth
    docdepth convert RUN scene --to nerfstudio
    docdepth convert RUN bag --to mcap
    docdepth convert RUN voxels --to occupancy
    docdepth convert RUN colored --to map
    """
    if to in EXPORTS and (camera or dataset):
        raise ConfigError(f"{to} is written of a run and all its cameras: leave the option out")
    with progress_bars() as progress:
        if to in EXPORTS:
            count = export(source, output, to, progress)
        else:
            count = converting.convert(source, output, to, dataset, camera, progress)
    if not volume.quiet:
        named = {
            "poses": POSE_FORMATS,
            "depth maps": DEPTH_FORMATS,
            "points": {"map"},
            "images": EXPORTS.keys() - {"occupancy", "map"},
        }
        what = next((what for what, formats in named.items() if to in formats), "sweeps")
        say(f"{count} {what} in {output}")
