"""Families of fields, one file each, and the folder is the registry: a new file is a new choice of --field.

A family's file holds FAMILY, a nerf.model.Family. The study's three differ in the space, the samplers and the extra
losses (nerf.volumetric.VolumetricFamily). Your own files: priors/extensions.py.
"""

from importlib import import_module

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
