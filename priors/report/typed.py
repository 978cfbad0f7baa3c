"""The command that makes a prior, written from its manifest."""

import shlex
from collections.abc import Mapping
from typing import Any

from priors import methods
from priors.cache import Prior
from priors.records import record, upgrade

FILTERS = {
    "SkyMask": ("sky", lambda step: "mask"),
    "SkyRows": ("sky-rows", lambda step: step["fraction"]),
    "Clip": ("clip", lambda step: step["farthest_m"]),
    "LeftRight": ("left-right", lambda step: step["most_px"]),
    "Confidence": ("confidence", lambda step: step["least"]),
    "Keep": ("keep", lambda step: step["fraction"]),
    "Density": ("density", lambda step: step["fraction"]),
}
"""A filter's flag, and its value of the filter's record."""


def build_command(prior: Prior) -> str:
    """Return the `priors build` that makes a prior anew: what was decided for 'auto' is named."""
    words = ["priors", "build", str(prior.drive.get("path", "DATA")), *_drive_flags(prior.drive)]
    words += ["--method", prior.method]
    if prior.method in methods.names():
        kind = methods.config_type(prior.method)
        usual = record(kind())
        own = upgrade(kind, prior.manifest.get("config", {}))
        changed = {name: value for name, value in own.items() if usual.get(name) != value}
        words += flags(changed, f"{prior.method}.")
    if reuse := prior.manifest.get("reuse"):
        words += ["--reuse", str(reuse["frames"])]
    for name, step in prior.manifest.get("filters", {}).items():
        if name == "TruthMask":
            words += ["--truth-mask"]
        elif name in FILTERS:
            flag, value = FILTERS[name]
            words += [f"--{flag}", _word(value(step))]
        if step.get("seed"):
            words += ["--density-seed", str(step["seed"])]
    return shlex.join([*words, "--cache", str(prior.folder.parent.parent)])


def flags(settings: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Return settings as the commands' flags: nested ones as --outer.inner, a switch that is off as --no-name."""
    words: list[str] = []
    for name, value in settings.items():
        flag = name.replace("_", "-")
        if isinstance(value, Mapping):
            words += flags(value, f"{prefix}{flag}.")
        elif isinstance(value, bool):
            words.append(f"--{prefix}{'' if value else 'no-'}{flag}")
        elif isinstance(value, list | tuple):
            words += [f"--{prefix}{flag}", *map(_word, value)]
        else:
            words += [f"--{prefix}{flag}", _word(value)]
    return words


def _drive_flags(drive: Mapping[str, Any]) -> list[str]:
    """Return the flags of a drive that its folder does not tell."""
    words = ["--camera", str(drive["camera"])] if drive.get("camera") else []
    return words + (["--truth", str(drive["truth"])] if drive.get("truth") else [])


def _word(value: Any) -> str:
    return f"{value:.10g}" if isinstance(value, float) else str(value)
