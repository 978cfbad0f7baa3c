"""Kernels: functions that numba compiles for one thread, once a machine; what was compiled is kept for the user.

    @compiled
    def fill(...): ...

The cache lies in $ROADPRIOR_CACHE, else in the user's cache folder, else (no home, nothing writable there) in the
temporary one: never in the installation, which may be read-only. It has a folder for each CPU mode and state of the
kernels' source: numba itself would not notice that a function called from another file has changed.
"""

import hashlib
import os
import sys
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from numba import njit
from numba.core.caching import CompileResultCacheImpl, FunctionCache, NullCache, _CacheLocator

from priors.machine.cpu import mode
from priors.machine.notices import on_compile, on_compiled
from priors.machine.pruning import mark_used, prune

FAST = {"reassoc", "contract", "nsz", "arcp"}
"""Floating-point freedoms of most kernels; neither nnan nor ninf: an overflow must stay visible."""


def compiled(function: Any = None, **options: Any) -> Any:
    """Decorate a function to be compiled at its first call, without Python's lock, and kept; `options`: numba's."""
    if function is None:
        return lambda function: compiled(function, **options)
    made = njit(function, nogil=True, **options)
    made._cache = _Cache(made.py_func) if _folder() else _NoCache(made.py_func.__name__)
    return made


def kept_in() -> Path | None:
    """Return the folder in which compiled functions are kept, whatever the CPU's mode; None: they are not."""
    folder = _folder()
    return None if folder is None else folder.parent


@cache
def _folder() -> Path | None:
    """Return the folder of what was compiled, that can be written; None where there is none."""
    name = f"{mode()}-{_digest()}"
    for place in _places():
        folder = place / name
        try:
            new = not folder.exists()
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
        except OSError:
            continue
        # What lies there is run: a folder that somebody else made under /tmp is not trusted.
        if not hasattr(os, "getuid") or folder.stat().st_uid == os.getuid():
            mark_used(folder)
            if new:
                prune(place)
            return folder
    return None


def _places() -> list[Path]:
    if "ROADPRIOR_CACHE" in os.environ:
        return [Path(os.environ["ROADPRIOR_CACHE"])]
    places = []
    with suppress(OSError):  # no temporary folder can be written either
        user = os.getuid() if hasattr(os, "getuid") else ""
        places.append(Path(tempfile.gettempdir()) / f"roadprior-kernels-{user}")
    home = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    try:
        return [(Path(home) if home else Path.home() / ".cache") / "roadprior" / "kernels", *places]
    except RuntimeError:  # no home
        return places


@cache
def _digest() -> str:
    """Hash the source of all kernels, and of what they are made of."""
    root = Path(__file__).resolve().parents[1]
    fields = root.parent / "nerf"
    ours = [*root.glob("kernels/*.py"), *fields.glob("kernels/**/*.py"), *fields.glob("**/types.py"), Path(__file__)]
    files = [file for file in ours if file.exists()]
    sums = hashlib.sha256(f"{sys.version} ".encode())
    for file in sorted(files):
        sums.update(file.read_bytes())
    return sums.hexdigest()[:12]


class _Locator(_CacheLocator):  # type: ignore[misc]
    """Where numba keeps a function."""

    def __init__(self, function: Any, file: str) -> None:
        self._py_file, self._line = file, function.__code__.co_firstlineno

    def get_cache_path(self) -> str:
        return str(_folder())

    def get_source_stamp(self) -> str:
        return _digest()

    def get_disambiguator(self) -> str:
        return f"{Path(self._py_file).parent.parent.name}-{self._line}"

    def ensure_cache_path(self) -> None:
        """Make it again where somebody deleted it meanwhile."""
        Path(self.get_cache_path()).mkdir(mode=0o700, parents=True, exist_ok=True)

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> "_Locator":
        return cls(py_func, py_file)


class _Impl(CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_Locator,)


class _Cache(FunctionCache):  # type: ignore[misc]
    """Numba's cache of a function, that tells when something is not in it, and when it is made."""

    _impl_class = _Impl

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return what was compiled for these types, or None after saying so."""
        found = super().load_overload(sig, target_context)
        if found is None:
            for tell in on_compile:
                tell(self._py_func.__name__)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled, and say that it is."""
        with suppress(OSError):  # a full disk: it is compiled again next time
            super().save_overload(sig, data)
        for tell in on_compiled:
            tell(self._py_func.__name__)


class _NoCache(NullCache):  # type: ignore[misc]
    """Nowhere to keep a function; that it is compiled is told all the same."""

    def __init__(self, name: str) -> None:
        self._name = name

    def load_overload(self, sig: Any, target_context: Any) -> None:
        """Say that it is to be compiled."""
        for tell in on_compile:
            tell(self._name)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Say that it is ready."""
        for tell in on_compiled:
            tell(self._name)
