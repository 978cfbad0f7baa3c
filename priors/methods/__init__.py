"""Methods: one file per prior, and the folder is the registry.

A method's file holds one frozen dataclass with the file's name in CamelCase (lidar.py: Lidar). Its fields are the
command line's flags, the cache's key and the manifest's record; called with a frame it returns a Depth. Your own
files: priors/extensions.py.
"""

from importlib import import_module
from typing import Any

from priors import extensions
from priors.errors import DataError

__path__.extend(extensions.folders("methods"))


def names() -> list[str]:
    """List the methods, without importing them."""
    return extensions.names(__path__)


def config_type(name: str) -> type[Any]:
    """Return a method's dataclass."""
    module, title = import_module(f"{__name__}.{name}"), name.title().replace("_", "")
    if not hasattr(module, title):
        raise DataError(f"{module.__file__}: a method's file needs a class {title}: see docs/architecture.md")
    method: type[Any] = getattr(module, title)
    return method
