"""What to call runs in tables and pictures: their folders' names."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path


def labels(folders: Sequence[Path]) -> list[str]:
    """Name the runs of a table, each differently: by its folder, and by those above it where several share a name."""
    parts = [folder.resolve().parts for folder in folders]  # '.' and '..' have no name of their own
    names = []
    for own in parts:
        count = 1
        while count < len(own) and Counter(other[-count:] for other in parts)[own[-count:]] > 1:
            count += 1
        names.append("/".join(own[-count:]))
    return names
