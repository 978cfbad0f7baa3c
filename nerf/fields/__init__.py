"""Families of fields, one file each, and the folder is the registry: a new file is a new choice of --field.

A family's file holds FAMILY, a nerf.model.Family. The study's three differ in the space, the samplers and the extra
losses (nerf.volumetric.VolumetricFamily).
"""

import pkgutil
from importlib import import_module

from nerf.model import Family
from priors.errors import DataError


def names() -> list[str]:
    """List the families, without importing them."""
    return sorted(module.name for module in pkgutil.iter_modules(__path__) if not module.name.startswith("_"))


def family(name: str) -> Family:
    """Return a family by its file's name.

    Raises:
        DataError: there is none of this name.
    """
    if name not in names():
        raise DataError(f"field {name}: no such family: choose one of {', '.join(names())}")
    chosen: Family = import_module(f"{__name__}.{name}").FAMILY
    return chosen
