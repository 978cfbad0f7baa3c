"""Keys: what decides a cache's maps, as a short hash, and the folder in which maps of the same decisions lie.

A key names a new folder; whether an old one holds the same maps is told by its manifest. So a cache is found again
after fields were renamed or added, whatever its key was made of. The key must not change without need: it is made of
the names that fields had first (priors/records.py), and tests/test_keys.py holds some.
"""

import hashlib
import json
from pathlib import Path
from typing import Any

from priors.cache import Prior, load
from priors.errors import DataError
from priors.records import Record, original, upgrade

LENGTH = 10
DECIDES = ("method", "version", "config", "filters", "sky", "weights", "fingerprint", "maps", "camera", "encoding")
"""Entries of a manifest that decide what the maps hold. The package's version is not among them: a method has its own,
raised when its maps change."""
DECIDES_WHERE_SET = ("reuse",)
"""Entries that decide, too, and that a manifest lacks where they are not in use."""


def key_of(parts: Record) -> str:
    """Hash what decides a result; the order of the entries does not matter."""
    text = json.dumps(parts, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:LENGTH]


def key(manifest: Record, kind: type[Any]) -> str:
    """Return the key of the maps that a manifest of today describes; its config is one of this kind of method."""
    names = [*DECIDES, *(name for name in DECIDES_WHERE_SET if name in manifest)]
    return key_of({name: manifest[name] for name in names} | {"config": original(kind, manifest["config"])})


def find(drive: Path, manifest: Record, kind: type[Any]) -> Prior | None:
    """Return the prior among a drive's that is of the same decisions as a manifest; None where there is none.

    A folder whose manifest cannot be read is left alone: its maps are nobody's.
    """
    wanted = _decisions(manifest, kind)
    for folder in sorted(drive.glob(f"{manifest['method']}-*")):
        try:
            prior = load(folder)
        except DataError:
            continue
        if _decisions(prior.manifest, kind) == wanted:
            return prior
    return None


def _decisions(manifest: Record, kind: type[Any]) -> Record:
    """Return what decides the maps, in today's names."""
    decides = {name: manifest.get(name) for name in (*DECIDES, *DECIDES_WHERE_SET)}
    config = decides["config"]
    return decides | {"config": upgrade(kind, config)} if isinstance(config, dict) else decides
