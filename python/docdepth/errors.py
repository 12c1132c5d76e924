"""Errors of docdepth. Each message names the file, the frame and the remedy."""


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


class BackendError(DocDepthError):
    """A renderer is unknown or cannot be used on this machine."""


class MissingExtraError(DocDepthError, ImportError):
    """An optional dependency is not installed."""
