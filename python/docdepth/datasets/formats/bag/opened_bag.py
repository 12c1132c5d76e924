"""A bag, what ``docdepth.yaml`` says of it, and how its frames lie to each other."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from docdepth.datasets.formats.bag.bag_file import BagFile, Message
from docdepth.datasets.formats.bag.bag_frames import StaticFrames
from docdepth.datasets.settings import CameraSettings, Numbers, RecordingSettings, Strict
from docdepth.errors import DatasetError

log = logging.getLogger(__name__)

_LONG_AGO = 10**18  # ns since 1970: the year 2001
_LATEST = 10**9  # ns; so much later than another a message hardly arrives


class BagLidarSettings(Strict):
    """A topic of points."""

    # takes its points to the frame of the first LiDAR; from the static transforms if left out
    T_lidar_sensor: Numbers | None = None
    angles: str | None = None  # of packets of a Hesai, see :func:`~.hesai.read_angles`
    # file of the metadata of an Ouster whose packets the topic holds; of the bag if left out
    metadata: str | None = None


class BagSettings(RecordingSettings):
    """What ``docdepth.yaml`` beside a bag may say."""

    # topics of points, the first of which gives stamps and frame. Needed where there are several
    lidars: dict[str, BagLidarSettings | None] = Field(default_factory=dict)
    # by topic of images, what the bag lacks
    cameras: dict[str, CameraSettings] = Field(default_factory=dict)
    # which times count: of the messages' headers, or of their recording
    stamps: Literal["header", "record"] = "header"
    # the frame whose place the topic ``poses`` tells, where its messages do not name it
    odometry_frame: str | None = None
    # takes points of the first LiDAR to the frame whose place the topic ``poses`` tells; from the
    # static transforms if left out
    T_odometry_lidar: Numbers | None = None


@dataclass(frozen=True)
class OpenedBag:
    """A bag and what is known of it."""

    file: BagFile
    settings: BagSettings
    frames: StaticFrames
    index: dict[str, list[Message]]  # messages of each topic of points and images

    @property
    def path(self) -> Path:
        """The bag."""
        return self.file.path

    def in_order(self, topic: str) -> tuple[list[Message], NDArray[np.int64]]:
        """Messages by their stamps, and nanoseconds of each, strictly increasing."""
        messages, file = self.index[topic], self.settings.file
        if self.settings.stamps == "record":
            return list(messages), self._distinct([m.recorded for m in messages], topic)
        none = sum(m.stamp == 0 for m in messages)
        # A simulation may begin at 0.
        if none == len(messages) or (none and max(m.stamp for m in messages) > _LONG_AGO):
            raise DatasetError(
                f"{self.path}, {topic}: {none} of {len(messages)} headers have no stamps; say "
                f"stamps: record in {file} to take the times of recording"
            )
        stamps = np.array([m.stamp for m in messages], np.int64)
        steps, early = np.diff(stamps), stamps < np.maximum.accumulate(stamps)
        # A message that comes late is alone. Where the clock was set, those behind it follow.
        if (early[1:] & early[:-1]).any() or steps.min(initial=0) < -_LATEST:
            k = int(steps.argmin())
            log.warning(
                "%s, %s: stamps jump back by %.1f s behind message %d; messages are taken in the "
                "order of their stamps. If the clock was set, say stamps: record in %s",
                self.path, topic, -steps[k] * 1e-9, k, file,
            )  # fmt: skip
        ordered = sorted(messages, key=lambda m: m.stamp)
        return ordered, self._distinct([m.stamp for m in ordered], topic)

    def _distinct(self, times: Sequence[int], topic: str) -> NDArray[np.int64]:
        found = np.array(times, np.int64)
        twice = np.flatnonzero(np.diff(found) <= 0)
        if len(twice):
            k = int(twice[0])
            raise DatasetError(
                f"{self.path}, {topic}: frames {k} and {k + 1} have one stamp, {found[k]} ns"
                f"{f', and {len(twice) - 1} more' if len(twice) > 1 else ''}; record the topic "
                f"once, or say stamps: record in {self.settings.file}"
            )
        return found
