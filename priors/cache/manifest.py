"""The manifest of a prior: what made its maps, as JSON.

A stranger who writes maps must say least: {"format": 2, "drive": {"path": "/where/the/drive/is"}}. What is not said
follows from the folders' names, or is not known. Format 1 is read as it is; it knows no checksums.
"""

import json
from pathlib import Path
from typing import Any

from eval.files import write_bytes
from priors.errors import DataError, unreadable

FORMAT = 2
FIRST_VERSION = 1
"""Of every method, in manifests of the time when the package's version stood for it."""
NAME = "manifest.json"
_OBJECTS = ("drive", "config", "filters", "camera")
"""Entries that are objects where they are there."""


class NewerFormatError(DataError):
    """A manifest that a later version wrote: it is neither read nor overwritten."""


def read(folder: Path) -> dict[str, Any]:
    """Read a prior's manifest, with what follows from the folders' names.

    Raises:
        NewerFormatError: a later version wrote it.
        DataError: it is missing or damaged.
    """
    path = folder / NAME
    try:
        manifest = json.loads(path.read_text(encoding="utf-8-sig"))
        found = manifest["format"]
        if isinstance(found, bool) or not isinstance(found, int) or found < 1:
            raise ValueError(f"format {found!r}")
        if found > FORMAT:
            raise NewerFormatError(
                f"{path}: cache format {found}, this version reads up to {FORMAT}: update roadprior, or leave this "
                "folder out (build into another one: --cache NEW)"
            )
        return _filled(manifest, folder)
    except (FileNotFoundError, NotADirectoryError) as error:
        raise DataError(f"{path}: no such file: not a prior's folder, or half written: {_MEND}") from error
    except OSError as error:
        raise unreadable(path, error) from error
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise DataError(f"{path}: damaged manifest: {_MEND}") from error


_MEND = "the `priors build` that made it writes it again and keeps the maps"


def write(folder: Path, manifest: dict[str, Any]) -> None:
    """Write a prior's manifest, also over a damaged one.

    Raises:
        NewerFormatError: a later version's is there.
        OSError: it cannot be written.
    """
    try:
        read(folder)
    except NewerFormatError:
        raise
    except DataError:
        pass  # none, or a damaged one
    write_bytes(folder / NAME, (json.dumps(manifest, indent=2, allow_nan=False) + "\n").encode())


def _filled(manifest: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Add what is not said; ValueError, KeyError or TypeError where it is no manifest."""
    for name in _OBJECTS:
        if not isinstance(manifest.get(name, {}), dict):
            raise TypeError(name)
    drive, home = manifest["drive"], folder.absolute()
    if not drive:
        raise KeyError("drive")
    method, _, key = home.name.partition("-")
    whole = {"version": FIRST_VERSION, "method": method, "key": key or home.name, **manifest}
    whole["drive"] = {"name": home.parent.name, **drive}
    named = (whole["method"], whole["key"], whole["drive"]["name"], whole["drive"].get("path", ""))
    if not all(isinstance(text, str) for text in named):
        raise TypeError("no text")
    if "path" in drive:
        whole["drive"]["path"] = str(home / drive["path"])  # a relative one begins at the manifest
    return whole
