"""Radiance fields of streets that lean on depth priors.

The names that a program of yours needs first are here: `from nerf import begin, SceneConfig`. Each is imported when it
is asked for. Their types stand in `__init__.pyi`.
"""

from importlib import import_module
from typing import Any

_HOMES = {
    "begin": "nerf.run",
    "open_run": "nerf.run",
    "Run": "nerf.run",
    "SceneConfig": "nerf.prepare",
    "FitConfig": "nerf.config",
}


def __getattr__(name: str) -> Any:
    """Import a name from its file."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
