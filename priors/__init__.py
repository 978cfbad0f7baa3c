"""Make, filter and cache metric depth priors for street drives.

The names that a program of yours needs first are here: `from priors import open_drive, Stereo, build`. Each is imported
when it is asked for, so that `import priors` stays quick and changes nothing of the process. Their types stand in
`__init__.pyi`.
"""

from priors.lazy import importer

_HOMES = {
    "open_drive": "priors.drives",
    "Camera": "priors.types",
    "Depth": "priors.types",
    "Drive": "priors.types",
    "Frame": "priors.types",
    "Method": "priors.types",
    "Lidar": "priors.methods.lidar",
    "Completion": "priors.methods.completion",
    "Stereo": "priors.methods.stereo",
    "Mono": "priors.methods.mono",
    "Filters": "priors.filters",
    "Prior": "priors.cache",
    "depth_html": "priors.draw.notebook",
    "DataError": "priors.errors",
}
__getattr__ = importer(__name__, _HOMES)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES, "__version__"})
