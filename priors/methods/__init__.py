"""Methods: one file per prior, and the folder is the registry.

A method's file holds one frozen dataclass, a priors.types.Method with the file's name in CamelCase (lidar.py: Lidar).
Its fields are the command line's flags, the cache's key and the manifest's record; called with a frame it returns a
Depth. Your own files: priors/extensions.py.
"""

from importlib import import_module

from priors import extensions
from priors.errors import DataError
from priors.types import Method

__path__.extend(extensions.folders("methods"))


def names() -> list[str]:
    """List the methods, without importing them."""
    return extensions.names(__path__)


def config_type(name: str) -> type[Method]:
    """Return a method's dataclass; DataError where a user's file has none."""
    module, title = import_module(f"{__name__}.{name}"), name.title().replace("_", "")
    method = vars(module).get(title)
    if not (isinstance(method, type) and issubclass(method, Method)):
        wanted = f"a class {title} that is a priors.types.Method"
        raise DataError(f"{module.__file__}: a method's file needs {wanted}: see docs/architecture.md")
    return method
