"""Radiance fields of streets that lean on depth priors.

The names that a program of yours needs first are here: `from nerf import begin, SceneConfig`. Each is imported when it
is asked for. Their types stand in `__init__.pyi`.
"""

from priors.lazy import importer

_HOMES = {
    "begin": "nerf.run",
    "open_run": "nerf.run",
    "Run": "nerf.run",
    "SceneConfig": "nerf.prepare",
    "FitConfig": "nerf.config",
}
__getattr__ = importer(__name__, _HOMES)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES, "__version__"})
