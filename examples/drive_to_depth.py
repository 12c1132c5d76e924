"""From a recorded drive to the depth map of one image.

    python examples/drive_to_depth.py DRIVE --camera image_02 --image 50 -o depth.npy

DRIVE is a recording in a format that docdepth reads (KITTI raw, KITTI odometry, a run folder).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import docdepth


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("drive", type=Path)
    parser.add_argument("--camera", required=True)
    parser.add_argument("--image", type=int, default=0, help="index of the image")
    parser.add_argument("-o", "--output", type=Path, default=Path("depth.npy"))
    args = parser.parse_args(arguments)

    drive = docdepth.open_dataset(args.drive)
    odometry = docdepth.register_drive(drive)
    labels = docdepth.classify_drive(odometry.sweeps, odometry.trajectory)
    scene = docdepth.Scene(odometry.sweeps, odometry.trajectory, labels)
    depth = docdepth.render_depth(scene, drive.cameras[args.camera], index=args.image)

    np.save(args.output, depth)  # float32 (h, w), metres, NaN = no depth
    print(f"{np.isfinite(depth).mean():.0%} of the pixels have depth; {args.output}")


if __name__ == "__main__":
    main()
