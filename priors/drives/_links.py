"""Symbolic links: a drive's folder may be a link. Calibration and poses may lie above the link or above its target."""

from contextlib import suppress
from pathlib import Path

MOST_HOPS = 20


def plain(path: Path) -> Path:
    """Return an absolute path that has a name: ~ is the home folder, and .. leads where the system says it leads.

    Links keep their names, but for those that a .. behind them leaves.
    """
    if path.parts[:1] and path.parts[0].startswith("~") and not path.exists():
        with suppress(RuntimeError):  # there is no such user: it is a name like others, and not there
            path = path.expanduser()
    parts = path.absolute().parts
    if ".." not in parts:
        return Path(*parts)
    behind = len(parts) - parts[::-1].index("..")
    return Path(*parts[:behind]).resolve().joinpath(*parts[behind:])


def homes(folder: Path, *inside: Path) -> list[Path]:
    """Return a drive's folder as it is named, then every folder that links lead to, each once.

    Args:
        folder: the drive's; it may be a link, to a link perhaps.
        inside: folders of its files (image_02/data), which may be links into another drive's folder.
    """
    found = [plain(folder)]
    while found[-1].is_symlink() and len(found) < MOST_HOPS:
        found.append(plain(found[-1].parent.resolve() / found[-1].readlink()))
    found.append(folder.resolve())
    for path in inside:
        depth = len(path.absolute().relative_to(folder.absolute()).parts)
        above = list(path.resolve().parents)
        if len(above) >= depth:
            found.append(above[depth - 1])
    return list(dict.fromkeys(found))


def beside(folders: list[Path], name: str, up: int = 0) -> Path:
    """Return the file `name` beside the first of the folders that has it, or `up` levels higher; else beside the first.

    The place need not be there.
    """
    places = [list(home.parents)[up] / name for home in folders if len(home.parents) > up]
    return next((place for place in places if place.exists()), places[0] if places else folders[0] / name)
