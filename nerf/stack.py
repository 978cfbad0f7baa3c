"""Memory-mapped stack of frames in one .npy file: written a frame at a time, read without ever being held.

What a process maps of a file counts as its memory, though the system could take it back at any time; and a few thousand
random pixels map hundreds of megabytes. So only small files are mapped: of large ones every pixel is a read of its own
(0.7 us each), and all are written by plain writes, which tell a full disk as an error where a map would kill.
"""

import os
import time
import uuid
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import numpy.typing as npt

SMALL_BYTES = 256 * 2**20
"""Files up to this are mapped."""
STALE_S = 3600.0
"""Age at which a half-written file is taken to be a killed run's."""


class Stack:
    """An array (frames, height, width, ...) in a file: stack[i] reads a frame, stack[frames, rows, columns] pixels."""

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file:
            np.lib.format.read_magic(file)
            self.shape, _, self.dtype = np.lib.format.read_array_header_1_0(file)
            self._start = file.tell()
        self._file = path.open("rb", buffering=0)
        self._mapped = np.load(path, mmap_mode="r") if path.stat().st_size <= SMALL_BYTES else None

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, index: int | tuple[npt.NDArray[Any], ...]) -> npt.NDArray[Any]:
        """Return a frame, or pixels by arrays (n,) of frame, row and column; always a copy."""
        if isinstance(index, tuple):
            return (
                self._pixels(np.ravel_multi_index(index, self.shape[:3]))
                if self._mapped is None
                else self._mapped[index]
            )
        position = range(len(self))[index]
        size = int(np.prod(self.shape[1:])) * self.dtype.itemsize
        raw = os.pread(self._file.fileno(), size, self._start + position * size)
        return np.frombuffer(bytearray(raw), self.dtype).reshape(self.shape[1:])

    def _pixels(self, flat: npt.NDArray[np.int64]) -> npt.NDArray[Any]:
        """Read pixels by their numbers (n,) in the whole array."""
        size = int(np.prod(self.shape[3:])) * self.dtype.itemsize
        file = self._file.fileno()
        raw = b"".join([os.pread(file, size, offset) for offset in (self._start + size * flat).tolist()])
        return np.frombuffer(bytearray(raw), self.dtype).reshape(-1, *self.shape[3:])


class StackWriter:
    """Writes a Stack's file frame by frame; where its `with` block fails, no file is left."""

    def __init__(self, path: Path, shape: tuple[int, ...], dtype: npt.DTypeLike) -> None:
        self._path, self._shape, self._dtype = path, shape, np.dtype(dtype)
        self._temporary = path.with_name(f".{path.name}.{os.getpid()}.{uuid.uuid4().hex[:8]}")
        self.written = 0
        """Frames so far."""

    def __enter__(self) -> Self:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        for old in self._path.parent.glob(f".{self._path.name}.*"):  # what a kill left behind
            if time.time() - old.stat().st_mtime > STALE_S:
                old.unlink(missing_ok=True)
        self._file = self._temporary.open("wb")
        header = {"descr": self._dtype.str, "fortran_order": False, "shape": self._shape}
        np.lib.format.write_array_header_1_0(self._file, header)
        return self

    def add(self, frame: npt.NDArray[Any] | int) -> None:
        """Append a frame, or one that holds a single value."""
        self._file.write(np.broadcast_to(np.asarray(frame, self._dtype), self._shape[1:]).tobytes())
        self.written += 1

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._file.close()  # the last bytes are written here
            if kind is None and self.written != self._shape[0]:
                raise ValueError(f"{self._path}: {self.written} of {self._shape[0]} frames written")
            if kind is None:
                self._temporary.replace(self._path)
        except OSError as late:
            raise OSError(late.errno, late.strerror, str(self._path)) from late
        finally:
            self._temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.filename is None:
            raise OSError(error.errno, error.strerror, str(self._path)) from error
