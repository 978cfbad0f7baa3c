"""Families of fields, one file each, and the folder is the registry: a new file is a new choice of --field.

A family's file holds FAMILY, a nerf.model.Family. The study's three differ in the space, the samplers and the extra
losses (nerf.volumetric.VolumetricFamily). Your own files: priors/extensions.py.
"""

from dataclasses import fields as parts
from dataclasses import is_dataclass
from importlib import import_module
from typing import Any

from nerf.config import FitConfig
from nerf.model import Family
from priors import extensions
from priors.errors import DataError

__path__.extend(extensions.folders("fields"))


def names() -> list[str]:
    """List the families, without importing them."""
    return extensions.names(__path__)


def family(name: str) -> Family:
    """Return a family by its file's name.

    Raises:
        DataError: there is none of this name, or the file has no FAMILY.
    """
    if name not in names():
        yours = f"or name the folder of your own by {extensions.VARIABLE}"
        raise DataError(f"unknown field {name!r}: choose one of {', '.join(names())}, {yours}")
    module = import_module(f"{__name__}.{name}")
    if not hasattr(module, "FAMILY"):
        raise DataError(f"{module.__file__}: a field family's file needs FAMILY: see docs/architecture.md")
    chosen: Family = module.FAMILY
    return chosen


def is_trained(name: str) -> bool:
    """Tell whether a family's models learn; the others are as good as their frames and prior at once."""
    return bool(getattr(family(name), "trained", True))


def aligns(name: str) -> bool:
    """Tell whether a family's models can learn a prior's scales and shifts with the field."""
    return bool(getattr(family(name), "aligns", False))


def shares(name: str) -> bool:
    """Tell whether several processes can fit one model of a family together."""
    return bool(getattr(family(name), "shares", False))


def rays_growth(name: str) -> float:
    """Return how many times as many rays a family's step with a prior has when a fit ends, where nobody says."""
    return float(getattr(family(name), "rays_growth", 1.0))


def unread(config: FitConfig) -> dict[str, Any]:
    """Return the flags of settings that are not the usual ones and that the config's family does not read."""
    names = getattr(family(config.model.family), "unread", ())
    return {flag: value for name in names for flag, value in _changed(config, FitConfig(), name.split(".")).items()}


def _changed(config: Any, usual: Any, path: list[str]) -> dict[str, Any]:
    """Return the flags of what differs from the usual in a setting, or in all settings of a part."""
    own, other, rest = getattr(config, path[0]), getattr(usual, path[0]), path[1:]
    if is_dataclass(own):
        each = [rest] if rest else [[field.name] for field in parts(own)]
        return {flag: value for inner in each for flag, value in _changed(own, other, inner).items()}
    if own == other:
        return {}
    flag = f"--{path[0].replace('_', '-')}"
    return {f"--no-{flag[2:]}": ""} if own is False else {flag: own}
