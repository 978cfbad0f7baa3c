"""Lazy names of a package: each is imported from its file when it is asked for, so that the package imports quickly."""

from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.metadata import version
from typing import Any


def importer(package: str, homes: Mapping[str, str]) -> Callable[[str], Any]:
    """Return a package's `__getattr__` (PEP 562); it knows `__version__` too.

    Args:
        package: its name, for the error.
        homes: name -> the module that has it.
    """

    def get(name: str) -> Any:
        if name == "__version__":
            return version("roadprior")
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(homes[name]), name)

    return get
