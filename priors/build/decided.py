"""Settings that 'auto' chose when a prior was built. The manifest keeps them, so the next build does not measure again.

    "decided": {"asked": {...}, "rig": "kitti", "made_of": {"image": {...}, "other": {...}, "sweep": {...}}}

It counts where the same is asked for of the same calibration and poses, and the files that were measured hold the same.
The manifest's config is then the answer. It decides nothing else: keys and maps are the same without it.
"""

from dataclasses import replace
from glob import escape
from pathlib import Path
from typing import Any, TypeVar

from priors.cache import load
from priors.cache.sources import Digests, watch, why_stale
from priors.errors import DataError
from priors.records import record, restore
from priors.types import Frame, Method

ENTRY = "decided"
Kind = TypeVar("Kind", bound=Method)


def decide(method: Kind, frame: Frame, home: Path, fingerprint: str) -> tuple[Kind, dict[str, Any] | None]:
    """Decide every 'auto' of a method, or recall it.

    Args:
        method: what is asked for.
        frame: the drive's first frame.
        home: the drive's folder in the cache.
        fingerprint: of the drive.

    Returns:
        The method with every 'auto' decided, and the manifest's entry; None where nothing can be kept.
    """
    if not method.measures or not frame.readers.keys() <= frame.files.keys():  # a file that is not known may change
        return method.resolve(frame), None
    for folder in sorted(home.glob(f"{escape(method.name)}-*")):
        recalled = _recall(method, frame, folder, fingerprint)
        if recalled is not None:
            return recalled
    watched = watch(frame)
    resolved = method.resolve(watched.frame)
    return resolved, {**_asked(method, frame), "made_of": watched.sources(Digests())}


def _recall(method: Kind, frame: Frame, folder: Path, fingerprint: str) -> tuple[Kind, dict[str, Any]] | None:
    """Return what a prior's manifest says of the same question; None where it says nothing, or files have changed."""
    try:
        manifest = load(folder).manifest
        decided, config = manifest.get(ENTRY), manifest.get("config")
        if not isinstance(decided, dict) or not isinstance(decided.get("made_of"), dict):
            return None
        same = manifest.get("fingerprint") == fingerprint and manifest["version"] == method.VERSION
        same &= {name: decided.get(name) for name in ("asked", "rig")} == _asked(method, frame)
        if not same or why_stale(decided["made_of"], frame, Digests()) is not None:
            return None
        answer = restore(type(method), config or {})
    except (DataError, TypeError, ValueError, KeyError, AttributeError):  # whatever another tool wrote there
        return None
    asked, answered = record(method), record(answer)
    open_before = {name: getattr(answer, name) for name in asked if asked[name] != answered[name]}
    return replace(method, **open_before), decided


def _asked(method: Method, frame: Frame) -> dict[str, Any]:
    return {"asked": record(method), "rig": None if frame.rig is None else frame.rig.name}
