"""Errors of docdepth. Each message names the file, the frame and the remedy."""

from pathlib import Path


class DocDepthError(Exception):
    """Base class of all errors that docdepth raises."""


class InputError(DocDepthError, ValueError):
    """An array has the wrong shape, dtype or content."""


class DatasetError(DocDepthError):
    """A recording on disk is missing, truncated or inconsistent."""


class CalibrationError(DocDepthError):
    """A camera or extrinsic calibration is missing or does not fit."""


class ConfigError(DocDepthError):
    """A parameter is unknown or out of its range."""


class OdometryError(DocDepthError):
    """Poses could not be computed or do not fit the sweeps."""


class RunError(DocDepthError):
    """A run folder cannot be used as it is."""


class DamagedFileError(RunError):
    """A file of a run is missing or damaged.

    Parameters
    ----------
    path : Path
    what : str
        What is wrong with it; empty if it is missing.
    """

    def __init__(self, path: Path, what: str) -> None:
        found = f"is damaged ({what})" if what else "is missing"
        super().__init__(f"{path} {found}; docdepth run RUN makes it again")
        self.path = path


class BackendError(DocDepthError):
    """A renderer is unknown or cannot be used on this machine."""


class MissingExtraError(DocDepthError, ImportError):
    """An optional dependency is not installed."""
