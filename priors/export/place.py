"""Where an export goes: a folder or a file that is new, or that an export of ours began or wrote.

A folder holds export.json, which says what was asked for. The same command goes on where it was stopped: files are
written whole or not at all, so those that are there are done. A folder or a file of somebody else is never touched.
"""

import hashlib
import json
from pathlib import Path
from typing import Any

from eval.files import drop_stale, write_bytes
from priors.errors import DataError
from priors.export.views import Views
from priors.text import read_json

NAME = "export.json"
README = "README.txt"
MARK = "roadprior"
"""Stands in every file that an export of ours writes alone."""
_LOOKED_AT = 4096


def record(views: Views, to: str, options: dict[str, Any]) -> dict[str, Any]:
    """Return what decides an export's files, as JSON holds it.

    Args:
        views: what is exported.
        to: the format.
        options: its settings.
    """
    lines = views.prior.lines()
    maps = json.dumps([[id_, lines.get(id_, {}).get("maps")] for id_ in views.ids], sort_keys=True)
    return {
        "made by": MARK,
        "to": to,
        "prior": views.prior.name,
        "drive": views.drive.name,
        "fingerprint": views.drive.fingerprint(),
        "frames": list(views.ids),
        "maps": hashlib.sha256(maps.encode()).hexdigest(),
        "filters": views.filters.record(),
        "options": options,
    }


def claim(folder: Path, asked: dict[str, Any]) -> None:
    """Begin an export in a folder, or go on with it.

    Raises:
        DataError: the folder holds files of somebody else, or an export that was asked for otherwise.
        OSError: it cannot be written.
    """
    path = folder / NAME
    if folder.exists() and not folder.is_dir():
        raise DataError(f"{folder}: is a file: name a new folder by --out")
    others = [entry for entry in folder.iterdir() if entry != path] if folder.exists() else []
    if path.exists() and others:
        found = read_json(path)
        if found != json.loads(json.dumps(asked)):
            told = f"holds another export (prior {found.get('prior')}, to {found.get('to')}, or other settings)"
            raise DataError(f"{folder}: {told}: delete it, or name another folder by --out")
        drop_stale(folder)
        return
    if others:
        raise DataError(f"{folder}: holds other files: name a new folder by --out")
    write_bytes(path, (json.dumps(asked, indent=1) + "\n").encode())


def expect_ours(path: Path) -> None:
    """Raise DataError where a file is there that no export of ours wrote."""
    if not path.exists():
        return
    with path.open("rb") as file:
        head = file.read(_LOOKED_AT)
        file.seek(max(0, path.stat().st_size - _LOOKED_AT))
        if MARK.encode() not in head + file.read(_LOOKED_AT):
            raise DataError(f"{path}: is there, and no export wrote it: name another file by --out")


def write_readme(folder: Path, views: Views, lines: list[str]) -> None:
    """Write README.txt: where the files come from, then what the format's lines say of units, frames and axes."""
    write_bytes(folder / README, "".join(f"{line}\n" for line in [*heading(views), "", *lines]).encode())


def heading(views: Views) -> list[str]:
    """Say where an export comes from."""
    filters = ", ".join(views.filters.record()) or "none"
    return [
        f"Written by {MARK}: prior {views.prior.name} of {views.drive.name}, {len(views)} frames, filters: {filters}.",
    ]


def origin_lines(views: Views) -> list[str]:
    """Say what was taken off the positions."""
    x, y, z = views.origin_m
    if not any(views.origin_m):
        return ["World frame: the drive's own. Nothing was taken off the positions."]
    return [
        "World frame: the drive's own, moved: it is far from zero, and most programs compute in float32.",
        f"Position in the drive's frame = position here + ({x:.0f}, {y:.0f}, {z:.0f}) m.",
    ]
