"""Extensions: a user's own data sets, methods and field families, in folders that ROADPRIOR_EXTENSIONS names.

    mine/drives/<name>.py   mine/methods/<name>.py   mine/fields/<name>.py

With ROADPRIOR_EXTENSIONS=mine, each file is a choice like those of the package: of --dataset, --method or --field.
docs/architecture.md has a recipe for each kind.
"""

import os
import pkgutil
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from priors.errors import DataError

VARIABLE = "ROADPRIOR_EXTENSIONS"


def folders(kind: str) -> list[str]:
    """Return a kind's folders (drives, methods or fields): a registry adds them to its package's __path__.

    Raises:
        DataError: a folder that the variable names is not there.
    """
    roots = [Path(root).absolute() for root in os.environ.get(VARIABLE, "").split(os.pathsep) if root]
    for root in roots:
        if not root.is_dir():
            raise DataError(f"{VARIABLE}: {root}: no such folder")
    return [str(root / kind) for root in roots]


def names(path: Iterable[str]) -> list[str]:
    """List the files of a registry's folders: its choices; those that begin with _ are none. Imports nothing.

    Raises:
        DataError: two folders have a file of one name.
    """
    files = Counter(module.name for folder in dict.fromkeys(path) for module in pkgutil.iter_modules([folder]))
    for name, count in files.items():
        if count > 1:
            raise DataError(f"{VARIABLE}: {count} files are named {name}.py: rename yours")
    return sorted(name for name in files if not name.startswith("_"))
