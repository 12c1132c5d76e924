"""A run as a data set of PyTorch, to train networks on its depth."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import InputError, MissingExtraError
from docdepth.pipeline.run_reader import Run, RunImage, open_run
from docdepth.render.layers import LAYERS


class DepthDataset:
    """Photos and depth of a run; a ``torch.utils.data.DataLoader`` takes it, with any workers.

    A sample is a dict:

    ``image``
        float32 (3, h, w), RGB from 0 to 1, without lens distortion
    ``depth``
        float32 (h, w), metres along the optical axis, 0 without depth
    ``valid``
        bool (h, w), where there is depth
    ``K``
        float32 (3, 3), pixels; that of the crop, where it is one
    ``T_world_camera``
        float64 (4, 4)
    ``time``, ``camera``, ``name``
        nanoseconds, and the names of camera and image

    and each layer under its name; of vectors their axis is the first: ``normal`` is (3, h, w).

    Parameters
    ----------
    layers : sequence of str
        Of :data:`docdepth.render.layers.LAYERS`, or ``moving``: bool, where something moves. The
        run should have stored them, by ``docdepth run --layers``: drawing takes seconds.
    crop : (int, int), optional
        Height and width of a part of the image, taken anywhere by the random numbers of PyTorch;
        the whole image if absent.
    cameras : iterable of str, optional
        Those of the recording if absent.
    """

    def __init__(
        self,
        run: Run | Path | str,
        layers: Sequence[str] = (),
        crop: tuple[int, int] | None = None,
        cameras: Iterable[str] | None = None,
    ) -> None:
        self._torch()
        run = run if isinstance(run, Run) else open_run(run)
        self.layers = (layers,) if isinstance(layers, str) else tuple(layers)
        self.crop = crop
        for name in self.layers:
            if name not in (*LAYERS, "moving"):
                raise InputError(f"unknown layer {name!r}; there are {', '.join(LAYERS)}, moving")
        recorded = (n for n, entry in run.folder.cameras.items() if entry.virtual is None)
        names = list(recorded if cameras is None else cameras)
        for name in names:
            if name not in run.cameras:
                raise InputError(f"{run.path} has no camera {name!r}; it has {[*run.cameras]}")
            camera = run.cameras[name].camera
            if crop is not None and not (
                0 < crop[0] <= camera.height and 0 < crop[1] <= camera.width
            ):
                raise InputError(
                    f"crop {crop} does not fit into {name} of {camera.height} x {camera.width}"
                )
        self.images: list[RunImage] = [image for name in names for image in run.cameras[name]]
        for name in names:
            if run.cameras[name][0].image is None:
                raise InputError(f"the recording of {run.path} has no photos of {name}")

    @staticmethod
    def _torch() -> Any:
        try:
            import torch
        except ImportError as error:
            raise MissingExtraError(
                'DepthDataset needs PyTorch: pip install "docdepth[torch]"'
            ) from error
        return torch

    def __len__(self) -> int:
        return len(self.images)

    def __repr__(self) -> str:
        crop = f", crop {self.crop}" if self.crop else ""
        return f"<DepthDataset: {len(self)} images{crop}>"

    def __getitem__(self, index: int) -> dict[str, Any]:
        torch, image = self._torch(), self.images[index]
        photo, depth, K = image.image, image.depth, image.K.astype(np.float32)
        if photo is None:
            raise InputError(f"there is no photo {image.name} of {image.of.name}")
        arrays: dict[str, NDArray[Any]] = {"image": photo.astype(np.float32) / 255, "depth": depth}
        for name in self.layers:
            arrays[name] = image.moving if name == "moving" else image.layers[name]
        if self.crop is not None:
            free = (n - m + 1 for n, m in zip(depth.shape, self.crop, strict=True))
            top, left = (int(torch.randint(n, ())) for n in free)
            K[:2, 2] -= left, top
            rows, columns = slice(top, top + self.crop[0]), slice(left, left + self.crop[1])
            arrays = {name: array[rows, columns] for name, array in arrays.items()}
        arrays["valid"] = np.isfinite(arrays["depth"])
        arrays["depth"] = np.nan_to_num(arrays["depth"])
        sample: dict[str, Any] = {"K": torch.from_numpy(K)}
        for name, array in arrays.items():
            if array.dtype == np.uint16:  # of which PyTorch knows little
                array = array.astype(np.int32)
            array = np.moveaxis(array, -1, 0) if array.ndim == 3 else array
            sample[name] = torch.from_numpy(np.ascontiguousarray(array))
        pose = torch.from_numpy(image.T_world_camera)
        return sample | {
            "T_world_camera": pose, "time": image.time,
            "camera": image.of.name, "name": image.name,
        }  # fmt: skip
