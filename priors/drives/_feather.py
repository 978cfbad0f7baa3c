"""Feather tables by pyarrow, which the extra argoverse2 brings."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from priors.errors import DataError

INSTALL = "pip install 'roadprior[argoverse2]'"


def read_feather(path: Path, columns: Sequence[str]) -> dict[str, npt.NDArray[np.generic]]:
    """Read columns of a table, each (n,).

    Raises:
        DataError: pyarrow is not installed, or the file is missing, damaged or lacks a column.
    """
    try:
        from pyarrow import ArrowInvalid, feather
    except ImportError as error:
        raise DataError(f"{path}: Argoverse 2 is read by pyarrow, which is not installed: {INSTALL}") from error
    if not path.is_file():
        raise DataError(f"{path}: no such file: download the log again")
    try:
        table = feather.read_table(path, memory_map=False)
    except (ArrowInvalid, OSError) as error:
        raise DataError(f"{path}: damaged feather file ({str(error).splitlines()[0]}): download it again") from error
    lacking = [name for name in columns if name not in table.column_names]
    if lacking:
        raise DataError(
            f"{path}: has no column {lacking[0]} (found {', '.join(table.column_names)}): download it again"
        )
    return {name: table.column(name).to_numpy() for name in columns}
