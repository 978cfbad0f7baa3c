"""Where priors are: a prior's own folder, a drive's, or a whole cache."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

from priors.cache.manifest import NAME
from priors.cache.prior import Prior, create, load
from priors.cache.store import mirror
from priors.errors import DataError

BUILD = "`priors build DATA --method stereo`"


def find(path: Path, on_refused: Callable[[DataError], None] | None = None) -> list[Prior]:
    """Return the priors at path: a prior's own folder, a drive's, or the whole cache.

    Args:
        path: the folder, or a store's URL: what lies there is brought here.
        on_refused: told of each prior that cannot be read (a damaged manifest, a later format), which is left out;
            without it the first of them is raised.

    Raises:
        DataError: there is no prior, or none that can be read.
    """
    path = mirror(path, pull=True)
    if not path.is_dir():
        what = (
            "is a file: name a folder of priors" if path.exists() else f"no such folder: build a prior first ({BUILD})"
        )
        raise DataError(f"{path}: {what}")
    priors, refused = [], []
    for folder in _folders(path):
        try:
            priors.append(load(folder))
        except DataError as error:
            refused.append(error)
    if refused and (not priors or on_refused is None):
        raise refused[0]
    for reason in refused if on_refused is not None else []:
        on_refused(reason)  # type: ignore[misc]
    if not priors:
        raise DataError(f"{path}: no priors in it: build one first ({BUILD})")
    return priors


def only(path: Path) -> Prior:
    """Return the one prior at path; DataError where there are several."""
    found = find(path)
    if len(found) > 1:
        raise DataError(f"{path}: holds {len(found)} priors: name one, for example {found[0].folder}")
    return found[0]


def holds_priors(path: Path) -> bool:
    """Tell whether a folder holds priors: it, its folders or theirs have a manifest."""
    return any(next(path.glob(pattern), None) for pattern in (NAME, f"*/{NAME}", f"*/*/{NAME}"))


def follow(prior: Prior) -> None:
    """Let the priors beside one tell the same place of the drive, where theirs is gone and it is the same drive."""
    own = prior.manifest
    for folder in sorted(prior.folder.parent.glob(f"*/{NAME}")):
        with suppress(DataError, OSError):  # one that cannot be read or written stays
            other = load(folder.parent)
            same = other.manifest.get("fingerprint") == own["fingerprint"]
            same &= other.drive.get("camera") == prior.drive.get("camera")
            if same and not Path(other.drive.get("path", "")).is_dir():
                truth = other.drive.get("truth")
                kept = {"truth": truth} if truth is not None and Path(truth).is_dir() else {}
                create(other.folder, {**other.manifest, "drive": {**prior.drive, **kept}})


def _folders(path: Path) -> Iterator[Path]:
    """Yield prior folders: those with a manifest, and those that have maps but lost it."""
    for pattern in (".", "*", "*/*"):
        for folder in [path] if pattern == "." else sorted(path.glob(pattern)):
            with suppress(OSError):  # a folder that cannot be looked into
                if (folder / NAME).exists() or (folder / "depth").is_dir():
                    yield folder
