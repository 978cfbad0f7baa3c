"""Methods: one file per prior, and the folder is the registry.

A method's file holds one frozen dataclass with the file's name in CamelCase (lidar.py: Lidar). Its fields are the
command line's flags, the cache's key and the manifest's record; called with a frame it returns a Depth.
"""

import pkgutil
from importlib import import_module

from priors.types import Method


def names() -> list[str]:
    """List the methods, without importing them."""
    return sorted(module.name for module in pkgutil.iter_modules(__path__) if not module.name.startswith("_"))


def config_type(name: str) -> type[Method]:
    """Return a method's dataclass."""
    method: type[Method] = getattr(import_module(f"{__name__}.{name}"), name.title().replace("_", ""))
    return method
