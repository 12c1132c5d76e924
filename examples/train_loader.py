"""Images and depth maps of a finished run, for training a depth network.

    docdepth run DRIVE -o RUN
    python examples/train_loader.py DRIVE RUN

PyTorch's data loader takes :class:`Samples`, with any number of workers. Pixels without depth are
NaN: compute the loss where the mask is true.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
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


class Samples(Sequence[Sample]):
    """Images of a drive that have a depth map of the first camera of a run."""

    def __init__(self, drive: Path, run: Path) -> None:
        camera = docdepth.RunFolder.open(run).camera_in("")
        self.stream, self.depth = docdepth.open_dataset(drive).cameras[camera], run / "depth"
        names = enumerate(self.stream.names) if self.stream.images else ()
        self.indices = [k for k, name in names if (self.depth / f"{name}.png").is_file()]

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, item: int) -> Sample:  # type: ignore[override]  # no slices
        index = self.indices[item]
        name, image = self.stream.names[index], self.stream.rectified_image(index)
        assert image is not None
        depth = docdepth.read_depth(self.depth / f"{name}.png")
        return Sample(name, image, depth, np.isfinite(depth))


def main(arguments: list[str]) -> None:
    for sample in Samples(*map(Path, arguments)):
        median = np.median(sample.depth[sample.mask])
        print(f"{sample.name}: {sample.mask.mean():.0%} with depth, median {median:.1f} m")


if __name__ == "__main__":
    main(sys.argv[1:])
