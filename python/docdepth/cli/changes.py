"""Parameters that a command has changed since a run was started."""

from __future__ import annotations

from docdepth.io.run_folder import RunFolder

_VERBS = {"odometry": "odometry", "ground": "classify", "dynamics": "classify"}
"""The verb that changes the parameters of a stage; ``render`` for all others."""


def changes_since_start(folder: RunFolder) -> list[str]:
    """A sentence for each verb that has changed parameters, with the command that goes back."""
    if folder.manifest.parameters_at_start is None:
        return []
    at_start = folder.manifest.parameters_at_start.model_dump(mode="json")
    now = folder.parameters.model_dump(mode="json")
    sentences: list[str] = []
    for verb in dict.fromkeys([*_VERBS.values(), "render"]):
        changed = [
            (f"{stage}.{name}", now[stage][name], value)
            for stage, values in at_start.items()
            if isinstance(values, dict) and _VERBS.get(stage, "render") == verb
            for name, value in values.items()
            if now[stage][name] != value
        ]
        if changed:
            what = ", ".join(f"{name} is {new}, was {old}" for name, new, old in changed)
            back = " ".join(f"--set {name}={old}" for name, _, old in changed)
            sentences.append(f"{what}; back: docdepth {verb} {folder.path} {back}")
    return sentences
