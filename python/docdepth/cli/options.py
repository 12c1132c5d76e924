"""Options that several verbs share, and what they mean together."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from functools import wraps
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Literal,
    TypeVar,
    get_args,
    get_origin,
    get_type_hints,
)

import typer
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from docdepth.cli.names import (
    DATASETS,
    FORMATS,
    LAYERS,
    PRESETS,
    RENDERERS,
    one_of,
    some_of,
)
from docdepth.datasets import experimental_formats
from docdepth.io.inputs import RunInputs
from docdepth.pipeline.execution import Execution

if TYPE_CHECKING:
    from docdepth.io.run_folder import RunFolder

_CHOICES = {"dataset": DATASETS, "renderer": RENDERERS}
"""Names that some fields take, beside those whose type lists them."""


def option(model: type[BaseModel], name: str) -> Any:
    """The option of a field of a model: its name, help, metavar, limits and completion."""
    field = model.model_fields[name]
    said = field.description or ""
    more: dict[str, Any] = {"metavar": (field.json_schema_extra or {}).get("metavar") or None}  # type: ignore[union-attr]
    if name in _CHOICES:
        said += f" One of {', '.join(_CHOICES[name])}."
        if name == "dataset":
            said += f" Never tried on a real recording: {', '.join(experimental_formats())}."
        more = one_of(_CHOICES[name])
    elif choices := _literal(field):
        more = one_of(choices)
    limits = {type(limit).__name__: limit for limit in field.metadata}
    if "Ge" in limits:
        more |= {"min": limits["Ge"].ge, "max": limits["Le"].le}
    return typer.Option(f"--{name.replace('_', '-')}", help=said, **more)


def _literal(field: FieldInfo) -> tuple[str, ...]:
    """The words of a field that takes one of some."""
    for kind in (field.annotation, *get_args(field.annotation)):
        if get_origin(kind) is Literal:
            return get_args(kind)
    return ()


def _type(field: FieldInfo) -> Any:
    """What the command line reads for a field; None if it is not given."""
    if field.annotation in (bool, int):
        return field.annotation
    kinds = get_args(field.annotation)
    if any(get_args(kind)[:1] == (Path,) for kind in kinds):
        return Path | None
    return list[str] | None if any(get_origin(kind) is tuple for kind in kinds) else str | None


def _default(field: FieldInfo) -> bool | int | None:
    """What an option is where it is not given, as the help shows it."""
    return field.default if isinstance(field.default, int) else None


_Function = TypeVar("_Function", bound=Callable[..., Any])


def with_options(
    *, but: Sequence[str] = (), **models: type[BaseModel]
) -> Callable[[_Function], _Function]:
    """Give a verb an option for each described field of some models.

    Parameters
    ----------
    but : sequence of str
        Fields without an option.
    **models
        By the argument of the verb, which gets the values of the options that were given.
    """
    fields = {
        argument: {
            name: field
            for name, field in model.model_fields.items()
            if field.description and not field.is_required() and name not in but
        }
        for argument, model in models.items()
    }

    def decorate(function: _Function) -> _Function:
        @wraps(function)
        def call(**values: Any) -> Any:
            for argument, of_model in fields.items():
                every = {name: values.pop(name) for name in of_model}
                values[argument] = {
                    name: v for name, v in every.items() if v not in (_default(of_model[name]), [])
                }
            return function(**values)

        hints = get_type_hints(function, include_extras=True)
        parameters: list[inspect.Parameter] = []
        for parameter in inspect.signature(function).parameters.values():
            kind = inspect.Parameter.KEYWORD_ONLY
            if parameter.name not in fields:
                hint = hints[parameter.name]
                parameters.append(parameter.replace(kind=kind, annotation=hint))
                continue
            model = models[parameter.name]
            for name, field in fields[parameter.name].items():
                hint = Annotated[_type(field), option(model, name)]
                parameters.append(
                    inspect.Parameter(name, kind, default=_default(field), annotation=hint)
                )
        call.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        call.__annotations__ = {p.name: p.annotation for p in parameters}
        return call  # type: ignore[return-value]

    return decorate


RunPath = Annotated[
    Path, typer.Argument(metavar="RUN", help="Run folder, as docdepth run -o made it.")
]
Output = Annotated[
    Path | None,
    typer.Option(
        "-o", "--output", metavar="RUN", help="Run folder: created, or continued if it is there."
    ),
]
GivenLabels = Annotated[Path | None, option(RunInputs, "labels")]
DatasetName = Annotated[str | None, option(RunInputs, "dataset")]
Frames = Annotated[str | None, option(RunInputs, "frames")]
CameraNames = Annotated[list[str] | None, option(RunInputs, "camera")]
Threads = Annotated[int, option(Execution, "threads")]
RendererName = Annotated[str, option(Execution, "renderer")]
PresetName = Annotated[
    str,
    typer.Option(
        "--preset",
        help="Values that all parameters start from: default (most accurate) or "
        "paper (the paper's method).",
        **one_of(PRESETS),
    ),
]
ChosenPreset = Annotated[
    str | None,
    typer.Option(
        "--preset",
        help="Values that all parameters start from: default (most accurate, taken if absent) or "
        "paper (the paper's method).",
        **one_of(PRESETS),
    ),
]
ConfigFile = Annotated[
    Path | None,
    typer.Option(
        "--config",
        metavar="FILE",
        help="YAML file of parameters by stage (odometry: {max_range: 80}), or the run.yaml of a "
        "run, whose recording and camera are then taken too. Options win over the file.",
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="STAGE.NAME=VALUE",
        help="Set one parameter, for example dynamics.tolerance=0.3; repeat it for more. "
        "docdepth parameters lists all.",
    ),
]
AllBelow = Annotated[
    Path | None,
    typer.Option(
        "--all",
        metavar="ROOT",
        help="Run every recording below this folder, the longest first, each into a folder of its "
        "own below -o. One that fails does not stop the others.",
    ),
]
OneCamera = Annotated[
    str | None,
    typer.Option("--camera", metavar="NAME", help="Camera; needed where the run has several."),
]
Formats = Annotated[
    list[str] | None,
    typer.Option(
        "--format",
        help=f"Files of each depth map: {', '.join(FORMATS)}; png if absent.",
        **some_of(FORMATS),
    ),
]
Scale = Annotated[
    float | None,
    typer.Option(
        metavar="X",
        help="PNG value of one metre: 256 as KITTI if absent, up to 255 m; 64 reaches 1023 m.",
    ),
]
LayerNames = Annotated[
    list[str] | None,
    typer.Option(
        "--layers",
        help=f"Further arrays per pixel, written beside the depth: {', '.join(LAYERS)}; none if "
        "absent.",
        **some_of(LAYERS),
    ),
]
VirtualPose = Annotated[
    str | None,
    typer.Option(
        "--pose",
        metavar="POSE",
        help="Draw for a virtual camera at this pose in the LiDAR frame (x forward, y left, "
        "z up): x,y,z looks ahead; x,y,z,qx,qy,qz,qw; or a file with a 4x4 matrix.",
    ),
]
VirtualIntrinsics = Annotated[
    str | None,
    typer.Option(
        "--K",
        metavar="FX,FY,CX,CY",
        help="Intrinsics of the virtual camera: focal lengths and principal point in pixels, "
        "for example 700,700,640,360.",
    ),
]
VirtualSize = Annotated[
    str | None,
    typer.Option(
        "--size",
        metavar="WxH",
        help="Image size of the virtual camera in pixels, for example 1280x720.",
    ),
]
VirtualName = Annotated[
    str | None,
    typer.Option(
        "--name",
        metavar="NAME",
        help="Name of the virtual camera: maps go to depth/NAME; virtual if absent.",
    ),
]
VirtualTimes = Annotated[
    Path | None,
    typer.Option(
        "--camera-times",
        metavar="FILE",
        help="Times of the virtual camera's images in seconds, one per line; those of the "
        "sweeps if absent.",
    ),
]
Json = Annotated[
    bool, typer.Option("--json", help="Print the result as JSON; messages go to standard error.")
]


def changes_of(settings: list[str] | None) -> dict[str, Any]:
    from docdepth.config import parse_settings

    return parse_settings(settings or [])


def output_of(
    format: list[str] | None, scale: float | None, layers: list[str] | None
) -> dict[str, Any]:
    """Parameters that have an option of their own."""
    chosen: dict[str, Any] = {}
    if format:
        chosen["output.format"] = ",".join(format)
    if scale is not None:
        chosen["output.scale"] = scale
    if layers:
        chosen["output.layers"] = ",".join(layers)
    return chosen


def reopen(path: Path, changes: dict[str, Any], *stages: str) -> RunFolder:
    """A run with some parameters of one stage replaced; kept in run.yaml once a stage uses them."""
    from docdepth.config import replaced
    from docdepth.io.run_folder import RunFolder

    check_stages(changes, *stages)
    folder = RunFolder.open(path)
    values = replaced(folder.parameters, changes)
    folder.manifest.parameters = values
    return folder


def check_stages(changes: dict[str, Any], *stages: str) -> None:
    """Refuse parameters of other stages."""
    from docdepth.errors import ConfigError

    for name in changes:
        if name.partition(".")[0] not in stages:
            raise ConfigError(f"--set {name}: this stage knows {' and '.join(stages)} only")
