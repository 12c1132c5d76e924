"""Iterate over images and depth maps of a finished run, for training a depth network.

    docdepth run DRIVE -o RUN
    python examples/train_loader.py DRIVE RUN

Yields NumPy arrays; wrap :func:`samples` in the loader of your framework. Pixels without depth are
NaN: compute the loss where the mask is true.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import docdepth


class Sample(NamedTuple):
    """One training sample; all arrays have the size of the image."""

    name: str
    image: NDArray[np.uint8]  # (h, w, 3), BGR, lens distortion removed
    depth: NDArray[np.float32]  # (h, w), metres along the optical axis, NaN = none
    mask: NDArray[np.bool_]  # (h, w), where there is depth


def samples(drive: Path, run: Path) -> Iterator[Sample]:
    """Images of a drive that have a depth map of the first camera of a run."""
    camera = docdepth.RunFolder.open(run).camera_in("")
    stream = docdepth.open_dataset(drive).cameras[camera]
    for index, name in enumerate(stream.names):
        file = run / "depth" / f"{name}.png"
        image = stream.rectified_image(index)
        if file.is_file() and image is not None:
            depth = docdepth.read_depth(file)
            yield Sample(name, image, depth, np.isfinite(depth))


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("drive", type=Path)
    parser.add_argument("run", type=Path)
    args = parser.parse_args(arguments)
    for sample in samples(args.drive, args.run):
        median = np.median(sample.depth[sample.mask])
        print(f"{sample.name}: {sample.mask.mean():.0%} with depth, median {median:.1f} m")


if __name__ == "__main__":
    main()
