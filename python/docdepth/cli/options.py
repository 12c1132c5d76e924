"""Options of the verbs: those of models and others; checked, and known to completion."""

from __future__ import annotations

import difflib
import inspect
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin

import typer
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from typer.core import TyperCommand, TyperOption

from docdepth._text import parse_settings
from docdepth.cli.terminal import app, set_volume, volume
from docdepth.config import DepthFormat, Layer, Preset
from docdepth.datasets import experimental_formats, format_names
from docdepth.errors import ConfigError
from docdepth.evaluation.depth import Mode
from docdepth.io.inputs import RunInputs
from docdepth.pipeline.execution import Execution

DATASETS = format_names()
RENDERERS = ("cpu", "egl", "egl:N", "osmesa")
PRESETS: tuple[str, ...] = get_args(Preset)
FORMATS: tuple[str, ...] = get_args(DepthFormat)
LAYERS: tuple[str, ...] = get_args(Layer)
MODES: tuple[str, ...] = get_args(Mode)

_CHOICES = {"dataset": DATASETS, "renderer": RENDERERS}
"""Names that some fields take, beside those whose type lists them."""

_Verb = TypeVar("_Verb", bound=Callable[..., Any])


def option(said: str, metavar: str | None = None, flags: str = "", **more: Any) -> Any:
    """An option of a verb: its help, and its names if they are not that of the argument."""
    return typer.Option(*flags.split(), help=said, **{"metavar": metavar, **more})


def one_of(names: Iterable[str], several: bool = False) -> dict[str, Any]:
    """Arguments of an option for one of these names, or for several with commas."""
    known = tuple(names)

    def parse(text: str) -> str:
        return ",".join(_name(part, known) for part in (text.split(",") if several else [text]))

    def complete(incomplete: str) -> list[str]:
        before, comma, last = incomplete.rpartition(",") if several else ("", "", incomplete)
        taken = before.split(",")
        return [before + comma + n for n in known if n.startswith(last) and n not in taken]

    parse.__name__ = "name"  # typer asks for it
    metavar = "NAME,..." if several else "NAME"
    return {"metavar": metavar, "parser": parse, "autocompletion": complete}


def _name(text: str, known: tuple[str, ...]) -> str:
    """The name that is meant; capitals do not matter, nor whether it has ``-`` or ``_``."""
    if re.fullmatch(r"egl:[0-9]{1,4}", text) and "egl:N" in known:
        return text
    plain = {_folded(name): name for name in known if name != "egl:N"}
    if _folded(text) in plain:
        return plain[_folded(text)]
    near = difflib.get_close_matches(_folded(text), plain, n=1)
    meant = f"; did you mean {plain[near[0]]}?" if near else ""
    raise typer.BadParameter(f"{text!r} is unknown; there are {', '.join(known)}{meant}")


def _folded(text: str) -> str:
    return text.strip().lower().replace("-", "_")


def option_of(model: type[BaseModel], name: str) -> Any:
    """The option of a field of a model: its name, help, metavar, limits and completion."""
    field = model.model_fields[name]
    said = field.description or ""
    more: dict[str, Any] = {"metavar": (field.json_schema_extra or {}).get("metavar") or None}  # type: ignore[union-attr]
    if name in _CHOICES:
        said += f" One of {', '.join(_CHOICES[name])}."
        if name == "dataset":
            said += f" Never tried on a real recording: {', '.join(experimental_formats())}."
        more = one_of(_CHOICES[name])
    for kind in (field.annotation, *get_args(field.annotation)):
        if get_origin(kind) is Literal:
            more = one_of(get_args(kind))
    limits = {type(limit).__name__: limit for limit in field.metadata}
    if "Ge" in limits:
        more |= {"min": limits["Ge"].ge, "max": limits["Le"].le}
    return option(said, flags=f"--{name.replace('_', '-')}", **more)


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


Quiet = Annotated[
    bool, option("Print only the result asked for, warnings and errors.", flags="--quiet -q")
]
Verbose = Annotated[
    bool, option("Print each step, and the traceback of a bug.", flags="--verbose -v")
]


_ALL = "docdepth.help_all"


def _help_all(ctx: typer.Context, wanted: bool) -> None:
    if wanted:
        ctx.meta[_ALL] = True
        typer.echo(ctx.get_help())
        raise typer.Exit


HelpAll = Annotated[
    bool, option("Show every option.", flags="--help-all", is_eager=True, callback=_help_all)
]


def _brief(common: Sequence[str]) -> type[TyperCommand]:
    """A command whose ``--help`` shows these options alone, each in a few words."""

    class Brief(TyperCommand):
        def format_help(self, ctx: Any, formatter: Any) -> None:
            if _ALL not in ctx.meta:
                for one in self.params:  # hidden only here: completion leaves hidden ones out
                    if isinstance(one, TyperOption):
                        one.hidden = one.name not in common
                        one.help = re.split(r"[.:;] ", one.help or "")[0].rstrip(".")
            super().format_help(ctx, formatter)

    return Brief


def verb(
    group: typer.Typer = app,
    name: str | None = None,
    *,
    but: Sequence[str] = (),
    common: Sequence[str] = (),
    **models: type[BaseModel],
) -> Callable[[_Verb], _Verb]:
    """Make a function a verb, which takes ``--quiet`` and ``--verbose`` as well.

    Parameters
    ----------
    name : str, optional
        That of the function if absent.
    but : sequence of str
        Fields of the models without an option.
    common : sequence of str
        Options that ``--help`` shows, where ``--help-all`` shows all; else it shows all.
    **models
        By an argument of the function: it gets the values of the options that were given of those
        that each described field has.
    """
    fields = {
        argument: {
            field_name: field
            for field_name, field in model.model_fields.items()
            if field.description and not field.is_required() and field_name not in but
        }
        for argument, model in models.items()
    }

    def register(function: _Verb) -> _Verb:
        @wraps(function)
        def call(quiet: bool, verbose: bool, **values: Any) -> Any:
            values.pop("help_all", None)
            set_volume(quiet or volume.quiet, verbose or volume.verbose)
            for argument, of_model in fields.items():
                every = {name: values.pop(name) for name in of_model}
                values[argument] = {
                    name: v for name, v in every.items() if v not in (_default(of_model[name]), [])
                }
            return function(**values)

        hints: dict[str, object] = {}
        defaults: dict[str, object] = {}
        for argument in inspect.signature(function, eval_str=True).parameters.values():
            if argument.name in fields:
                for field_name, field in fields[argument.name].items():
                    of_field = option_of(models[argument.name], field_name)
                    hints[field_name] = Annotated[_type(field), of_field]
                    defaults[field_name] = _default(field)
            else:
                hints[argument.name] = argument.annotation
                defaults[argument.name] = argument.default
        more = {"quiet": Quiet, "verbose": Verbose} | ({"help_all": HelpAll} if common else {})
        hints |= more
        defaults |= dict.fromkeys(more, False)
        call.__signature__ = inspect.Signature([  # type: ignore[attr-defined]
            inspect.Parameter(
                name, inspect.Parameter.KEYWORD_ONLY, default=defaults[name], annotation=hint
            )
            for name, hint in hints.items()
        ])  # fmt: skip
        call.__annotations__ = hints
        call.__doc__ = _unwrapped(function)
        shown = (*common, *more, "help")
        group.command(name, cls=_brief(shown) if common else None)(call)
        return function

    return register


def _unwrapped(function: Callable[..., Any]) -> str:
    """The help of a verb with each paragraph in one line; indented lines are examples and stay."""
    paragraphs = inspect.cleandoc(function.__doc__ or "").split("\n\n")
    return "\n\n".join(p if p.startswith(" ") else " ".join(p.split("\n")) for p in paragraphs)


RunPath = Annotated[
    Path, typer.Argument(metavar="RUN", help="Run folder, as docdepth run -o made it.")
]
DatasetName = Annotated[str | None, option_of(RunInputs, "dataset")]
Threads = Annotated[int, option_of(Execution, "threads")]
OneCamera = Annotated[
    str | None, option("Camera; needed where the run has several.", "NAME", "--camera")
]
PresetName = Annotated[
    str,
    option(
        "Values that all parameters start from: default (most accurate) or paper (the paper's "
        "method).",
        flags="--preset",
        **one_of(PRESETS),
    ),
]
Settings = Annotated[
    list[str] | None,
    option(
        "Set one parameter, for example dynamics.tolerance=0.3; repeat it for more. docdepth "
        "parameters lists all.",
        "NAME=VALUE",
        "--set",
    ),
]
Formats = Annotated[
    list[str] | None,
    option(
        f"Formats of the depth maps ({', '.join(FORMATS)}); png if absent.",
        **one_of(FORMATS, several=True),
    ),
]
Scale = Annotated[
    float | None,
    option("PNG value of one metre: 256 as KITTI if absent, up to 255 m; 64 reaches 1023 m.", "X"),
]
LayerNames = Annotated[
    list[str] | None,
    option(
        f"More arrays per pixel ({', '.join(LAYERS)}), written beside the depth; none if absent.",
        **one_of(LAYERS, several=True),
    ),
]
Json = Annotated[
    bool, option("Print the result as JSON; messages go to standard error.", flags="--json")
]


def changes(
    settings: list[str] | None,
    format: list[str] | None,
    scale: float | None,
    layers: list[str] | None,
) -> dict[str, object]:
    """Parameters that options change: those of ``--set``, and those with an option of their own."""
    chosen: dict[str, object] = {}
    if format:
        chosen["output.format"] = ",".join(format)
    if scale is not None:
        chosen["output.scale"] = scale
    if layers:
        chosen["output.layers"] = ",".join(layers)
    return parse_settings(settings or []) | chosen


def check_stages(changed: Mapping[str, object], *stages: str) -> None:
    """Refuse parameters of other stages."""
    for name in changed:
        if name.partition(".")[0] not in stages:
            raise ConfigError(f"--set {name}: this stage knows {' and '.join(stages)} only")
