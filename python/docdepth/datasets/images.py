"""Images of a recording: files of their own, or stored within another file such as a bag."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.files import read_image


@dataclass(frozen=True)
class StoredImage:
    """An image within a file.

    It has the members of a Path that docdepth asks images for; ``stat`` is that of the file.
    """

    file: Path
    name: str  # for messages
    # returns the image: ndarray of uint8, shape (height, width, 3), BGR
    read: Callable[[], NDArray[np.uint8]]

    def __fspath__(self) -> str:
        return str(self.file / self.name)

    def __str__(self) -> str:
        return f"{self.file} ({self.name})"

    @property
    def parent(self) -> Path:
        """The file that holds it."""
        return self.file

    def stat(self) -> os.stat_result:
        """Size and time of the file that holds it."""
        return self.file.stat()

    def is_file(self) -> bool:
        """Whether the file that holds it is there."""
        return self.file.is_file()


ImageSource = Path | StoredImage


def read_image_of(image: ImageSource) -> NDArray[np.uint8]:
    """An image as BGR, wherever it is."""
    return image.read() if isinstance(image, StoredImage) else read_image(Path(image))


def file_of(image: ImageSource) -> Path:
    """The file that an image is, or is in."""
    return image.file if isinstance(image, StoredImage) else image
