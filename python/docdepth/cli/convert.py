"""The verb that writes poses, labels and depth for other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from docdepth.cli.options import DatasetName, one_of, option, verb
from docdepth.cli.terminal import progress_bars, say, volume
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
            metavar="OUT", help="New file of poses, new folder of labels, or folder of depth."
        ),
    ],
    to: Annotated[
        str,
        option(
            f"Poses: {', '.join(POSE_FORMATS)}. Labels: label (SemanticKITTI), classid (NPY), "
            "pcd (as DynamicMap_Benchmark, the class as intensity). Depth: proj_depth (as KITTI "
            "releases it, OUT/DRIVE/proj_depth/groundtruth/CAMERA).",
            **one_of((*POSE_FORMATS, *LABEL_FORMATS, *DEPTH_FORMATS)),
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
    """Write poses, labels or depth of a run or a recording in the format of other tools.

    docdepth convert RUN poses.txt --to tum
    docdepth convert RUN labels --to classid
    docdepth convert RUN release --to proj_depth
    """
    with progress_bars() as progress:
        count = converting.convert(source, output, to, dataset, camera, progress)
    if not volume.quiet:
        what = "poses" if to in POSE_FORMATS else "depth maps" if to in DEPTH_FORMATS else "sweeps"
        say(f"{count} {what} in {output}")
