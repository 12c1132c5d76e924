"""Files of recordings, and images in them: what cannot be read ends in a sentence that names it.

Some sweeps or images may be broken: then others beside them tell what a recording is like.
"""

from __future__ import annotations

import os
import threading
import warnings
import weakref
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from docdepth.errors import CalibrationError, DatasetError, DocDepthError, MissingExtraError
from docdepth.io.images import decode_photo
from docdepth.io.untrusted import as_utf_8, read_file, read_text

_Opened = TypeVar("_Opened")
_File = TypeVar("_File")
_Read = TypeVar("_Read")
_MOST_NAMED = 8  # in an error
_MOST_TRIES = 100  # sweeps or images that are tried in place of a broken one
FILE = "docdepth.yaml"
"""What the files of a recording do not tell."""


def settings_file(recording: Path) -> Path:
    """``docdepth.yaml`` in the folder of a recording, or beside one that is no folder."""
    return (recording if recording.is_dir() else recording.parent) / FILE


def files_of(folder: Path, *suffixes: str) -> list[Path]:
    """Files of a folder with these suffixes, in small letters or others, by name.

    Hidden files are left out: other systems put ``._000000.bin`` beside each file that they copy.
    """
    files = folder.iterdir() if folder.is_dir() else ()
    return sorted(f for f in files if f.suffix.lower() in suffixes and not f.name.startswith("."))


def is_there(file: Path) -> bool:
    """Whether an optional file exists."""
    if file.is_file():
        return True
    if file.is_symlink() or file.exists():
        raise unreadable(file, "put the file there, or remove it")
    return False


def unreadable(
    file: Path, remedy: str, error: OSError | None = None, where: str = ""
) -> DatasetError:
    """The error of a file that is there, missing or no file, whichever it is."""
    where = where or str(file)
    if file.is_dir():
        return DatasetError(f"{where} is a folder where a file is expected; {remedy}")
    if file.is_symlink() and not file.exists():
        return DatasetError(f"{where} is a link to {file.readlink()}, which is missing; {remedy}")
    if isinstance(error, PermissionError):
        return DatasetError(f"{where} may not be read by you; change its permissions")
    if file.exists():
        why = "it is no regular file" if error is None else error.strerror
        return DatasetError(f"{where} cannot be read ({why}); {remedy}")
    return DatasetError(f"{where} is missing; {remedy}")


def read_bytes(file: Path, remedy: str, where: str = "") -> bytes:
    """The content of a file, which errors name by ``where`` if it is given."""
    try:
        return read_file(file)
    except OSError as error:
        raise unreadable(file, remedy, error, where) from None


def read_lines(file: Path, remedy: str) -> list[str]:
    """The lines of a text file without blank ones at its end."""
    try:
        return read_text(file).rstrip().splitlines()
    except OSError as error:
        raise unreadable(file, remedy, error) from None
    except UnicodeDecodeError:
        raise DatasetError(f"{file} is not a text file; {remedy}") from None


def read_numbers(file: Path, remedy: str) -> list[float]:
    """All numbers of a text file of a calibration."""
    try:
        return [float(word) for line in read_lines(file, remedy) for word in line.split()]
    except ValueError:
        raise CalibrationError(f"{file} is no matrix of numbers; {remedy}") from None
    except DatasetError as error:
        raise CalibrationError(str(error)) from None


def read_json(
    file: Path, remedy: str, form: type[_Read], error: type[DocDepthError] = DatasetError
) -> _Read:
    """The content of a JSON file, which has this form, in pydantic's words; more is ignored."""
    content = read_bytes(file, remedy)
    try:
        return TypeAdapter(form).validate_json(as_utf_8(content))
    except UnicodeDecodeError:
        raise error(f"{file} is not a text file; {remedy}") from None
    except ValidationError as failed:
        (first, *_) = failed.errors()
        found = ": ".join([*map(str, first["loc"]), first["msg"]])
        raise error(f"{file} is not as it should be ({found}); {remedy}") from None


def _is_inside(path: str) -> str:
    path = path.replace("\\", "/")  # of Windows
    if not path or "\0" in path or path.startswith("/") or ".." in path.split("/"):
        raise ValueError("it leads out of the recording")
    return path


class Entry(BaseModel):
    """Part of a JSON file; a number of it is finite."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)


PathInside = Annotated[str, AfterValidator(_is_inside)]
Microseconds = Annotated[int, Field(ge=0, lt=9 * 10**15)]
Seconds = Annotated[float, Field(ge=0, lt=9e9, allow_inf_nan=False)]
"""As nanoseconds they fit into 64 bits."""


def read_image(file: Path) -> NDArray[np.uint8]:
    """An image as BGR, from a path of any bytes."""
    image = decode_photo(read_bytes(file, "copy the image again"))
    if image is None:
        raise DatasetError(f"{file} is not a readable image; replace or remove it")
    return image


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


def images_if_any(files: list[Path]) -> list[Path]:
    """The images of a camera; none where no file of them is there."""
    return files if any(file.is_file() for file in files) else []


def file_of(image: ImageSource) -> Path:
    """The file that an image is, or is in."""
    return image.file if isinstance(image, StoredImage) else image


@contextmanager
def library_errors(where: str, remedy: str, reason: str = "") -> Iterator[None]:
    """What a library raises about a file that ``where`` names is an error of docdepth.

    ``reason`` stands in it in place of the library's own words.
    """
    try:
        yield
    except (DocDepthError, OSError, MemoryError):
        raise
    except UnicodeEncodeError:
        raise DatasetError(
            f"{where}: the bytes of this path are no text, and the library that reads it takes "
            "only text; rename it, in letters"
        ) from None
    except Exception as error:
        raise DatasetError(f"{where} is damaged ({reason or repr(error)}); {remedy}") from error


@contextmanager
def suggest_skipping() -> Iterator[None]:
    """If a sweep or an image is broken, say how a run leaves it out."""
    try:
        yield
    except DatasetError as error:
        raise DatasetError(error, "or leave it out by `on_error='skip'`", code=error.code) from None


def first_readable(read: Callable[[_File], _Read], files: Sequence[_File]) -> _Read:
    """What ``read`` gives for the first whole file; the error of the first if none is."""
    return next(iter(readable(lambda k: read(files[k]), [0], len(files)).values()))


def readable(
    read: Callable[[int], _Read],
    wanted: Iterable[int],
    count: int,
    broken: list[DocDepthError] | None = None,
) -> dict[int, _Read]:
    """What ``read`` gives for frames that are ``wanted``, or for frames near those that are broken.

    Of ``count`` frames; by frame, in order. ``broken`` gets the errors of those that were wanted.
    If none around one of them can be read, its error is raised.
    """
    found: dict[int, _Read] = {}
    for index in wanted:
        around = range(max(index - _MOST_TRIES, 0), min(index + _MOST_TRIES + 1, count))
        problem: DocDepthError | None = None
        for _, other in sorted((abs(k - index), k) for k in around):
            if other in found:
                break
            try:
                found[other] = read(other)
                break
            except DocDepthError as error:
                problem = problem or error
        else:
            if problem is not None:
                raise problem
        if problem is not None and broken is not None:
            broken.append(problem)
    return dict(sorted(found.items()))


def one_of(root: Path, what: str, known: Sequence[str], wanted: str | None) -> str:
    """The name that is wanted, or the only one that ``root`` has of ``what``."""
    if wanted is None and len(known) == 1:
        return known[0]
    if wanted is None or wanted not in known:
        some = ", ".join(str(root / one) for one in known[:_MOST_NAMED])
        more = f" and {len(known) - _MOST_NAMED} more" if len(known) > _MOST_NAMED else ""
        if not known:
            raise DatasetError(f"{root} has no {what}; unpack it again")
        raise DatasetError(
            f"{root} has {len(known)} {what}{'' if wanted is None else f', but no {wanted}'}; name "
            f"one of {some}{more}"
        )
    return wanted


def extra(module: str, what: str, name: str) -> Any:
    """The module of a library that comes in the extra ``name`` of docdepth.

    ``what`` needs it, as in "bags need rosbags": without it an error says how to install it.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return import_module(module)
    except ImportError:
        raise MissingExtraError(f"{what}: pip install 'docdepth[{name}]'") from None


class OpenedOnce(Generic[_Opened]):
    """What a function opens: once in each process, for one thread at a time, by ``with``.

    Parameters
    ----------
    open : callable
        A function of a module, or a partial of one: another process gets it and opens anew.
    """

    def __init__(self, open: Callable[[], _Opened]) -> None:
        self._open, self._lock, self._by = open, threading.RLock(), 0

    def __reduce__(self) -> tuple[type[OpenedOnce[_Opened]], tuple[Callable[[], _Opened]]]:
        return OpenedOnce, (self._open,)

    def __enter__(self) -> _Opened:
        self._lock.acquire()
        try:
            if self._by != os.getpid():
                self._value, self._by = self._open(), os.getpid()
                if hasattr(self._value, "close"):
                    weakref.finalize(self, self._value.close)
            return self._value
        except BaseException:
            self._lock.release()
            raise

    def __exit__(self, *_: object) -> None:
        self._lock.release()
