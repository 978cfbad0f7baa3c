"""A cache in an object store (s3://BUCKET/CACHE, gs://...), through fsspec, with a mirror of it on this machine.

    ~/.cache/roadprior/stores/<digest of the URL>/.url                   what it mirrors
                                                 /<drive>/<prior>/...    files as in a cache on a disk

A store has no rename, no append and no locks. An object is there whole or not at all, so a map's depth is put last, as
it is renamed last on a disk. Lines of the journal are put as parts, journal/<process>-<n>.jsonl, before the depth that
they are of; the mirror's frames.jsonl has the lines of all parts. A build leaves no maps in the mirror.
"""

import errno
import hashlib
import json
import os
import re
import threading
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any

from eval.files import write_bytes
from priors.errors import DataError

URL = re.compile(r"([a-z][a-z0-9+.-]*):/+(.+)")
MARK, INDEX, JOURNAL, PARTS = ".url", ".index.json", "frames.jsonl", "journal"
LINES = 64
"""Of a part of the journal: it is put anew with each line."""


def is_store(path: Path) -> bool:
    """Tell whether a path is a store's URL, whose slashes a Path has run together."""
    return URL.fullmatch(path.as_posix()) is not None and not path.exists()


def mirror(path: Path, *, pull: bool = False) -> Path:
    """Return the folder that stands for a path: itself, or a store's mirror.

    Args:
        path: a folder, or the URL of one in a store.
        pull: bring all that lies there into the mirror.

    Raises:
        DataError: fsspec, or what it needs for the store, is not installed.
        OSError: the store cannot be reached.
    """
    if not is_store(path):
        return path
    found = URL.fullmatch(path.as_posix())
    assert found is not None
    url = f"{found[1]}://{found[2]}"
    home = Path(os.environ.get("ROADPRIOR_CACHE") or Path.home() / ".cache" / "roadprior") / "stores"
    folder = home / hashlib.sha256(url.encode()).hexdigest()[:16]
    if not (folder / MARK).exists():
        write_bytes(folder / MARK, url.encode())
    if pull:
        Store(folder, url).pull("")
    return folder


def store_of(folder: Path) -> "Store | None":
    """Return the store that a folder, or one above it, mirrors; None for a folder of a disk."""
    for parent in (folder, *list(folder.parents)[:3]):
        with suppress(OSError):
            return Store(parent, (parent / MARK).read_text(encoding="utf-8"))
    return None


def publish(path: Path) -> None:
    """Put a file of a mirror into its store; nothing for a file of a disk."""
    store = store_of(path.parent)
    if store is not None:
        store.put(path)


@dataclass
class Store:
    """A store and its mirror."""

    folder: Path
    """The mirror."""
    url: str
    """Where it lies in the store."""
    _process: str = field(default_factory=lambda: f"{os.getpid()}-{uuid.uuid4().hex[:8]}")
    _lines: list[bytes] = field(default_factory=list)
    _part: int = 0
    _adding: threading.Lock = field(default_factory=threading.Lock)

    @cached_property
    def _fs(self) -> tuple[Any, str]:
        """Return fsspec's file system, and the root in it."""
        try:
            from fsspec.core import url_to_fs
        except ImportError as error:
            raise DataError(f"{self.url}: needs fsspec: pip install 'roadprior[cluster]'") from error
        try:
            fs, root = url_to_fs(self.url, use_listings_cache=False)
        except (ImportError, ValueError) as error:
            raise DataError(f"{self.url}: {str(error).splitlines()[0]}") from error
        return fs, str(root)

    def names(self, below: str) -> dict[str, Any]:
        """Return the objects below a folder of the mirror: names relative to the mirror -> what tells their content."""
        fs, root = self._fs
        place = f"{root}/{below}" if below else root
        with self._told(below):
            listed = fs.find(place, detail=True)
        start = len(root.rstrip("/")) + 1
        return {name[start:]: _content(about) for name, about in listed.items()}

    def pull(self, below: str, suffixes: tuple[str, ...] = ("",)) -> None:
        """Bring what lies below a folder and has changed into the mirror, and join the journals' parts.

        Args:
            below: relative to the mirror; "": all.
            suffixes: of the names that are wanted.
        """
        known = self._index()
        for name, content in self.names(below).items():
            path = self.folder / name
            if name.endswith(suffixes) and (known.get(name) != content or not path.exists()):
                write_bytes(path, self.get(name))
                known[name] = content
        write_bytes(self.folder / INDEX, json.dumps(known).encode())
        for parts in (self.folder / below).rglob(PARTS) if (self.folder / below).is_dir() else []:
            _join(parts)

    def get(self, name: str) -> bytes:
        """Return an object's bytes; `name` relative to the mirror."""
        fs, root = self._fs
        with self._told(name):
            return bytes(fs.cat_file(f"{root}/{name}"))

    def put(self, path: Path) -> None:
        """Put a file of the mirror into the store: it is there whole or not at all."""
        self._put(path.relative_to(self.folder).as_posix(), path.read_bytes())

    def add_line(self, prior: Path, line: dict[str, Any]) -> None:
        """Put a line of a prior's journal into this process's part."""
        with self._adding:
            if len(self._lines) == LINES:
                self._lines.clear()
                self._part += 1
            self._lines.append((json.dumps(line) + "\n").encode())
            part = f"{prior.relative_to(self.folder).as_posix()}/{PARTS}/{self._process}-{self._part:06d}.jsonl"
            self._put(part, b"".join(self._lines))

    def _put(self, name: str, data: bytes) -> None:
        fs, root = self._fs
        with self._told(name):
            fs.pipe_file(f"{root}/{name}", data)

    def _index(self) -> dict[str, Any]:
        with suppress(OSError, ValueError):
            known = json.loads((self.folder / INDEX).read_bytes())
            return known if isinstance(known, dict) else {}
        return {}

    @contextmanager
    def _told(self, name: str) -> Iterator[None]:
        """Name the object in what the store refuses; its client's errors are of many kinds."""
        try:
            yield
        except DataError:
            raise
        except Exception as error:
            number = getattr(error, "errno", None) or errno.EIO
            reason = str(error).partition("\n")[0] or type(error).__name__
            raise OSError(number, reason, f"{self.url}/{name}".rstrip("/")) from error


def _content(about: dict[str, Any]) -> list[str]:
    """Return what tells an object's content."""
    version = about.get("ETag") or about.get("etag") or about.get("mtime") or about.get("created") or ""
    return [str(about.get("size")), str(version)]


def _join(parts: Path) -> None:
    """Write a prior's journal anew of its parts; those of one process are in order."""
    texts = [path.read_bytes() for path in sorted(parts.glob("*.jsonl"), key=lambda path: PurePosixPath(path).name)]
    write_bytes(parts.parent / JOURNAL, b"".join(texts))
