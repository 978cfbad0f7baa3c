"""Memory-mapped stack of frames in one .npy file: written a frame at a time, read without ever being held.

What a process maps of a file counts as its memory, though the system could take it back at any time; and a few thousand
random pixels map hundreds of megabytes. So only small files are mapped: of large ones every pixel is a read of its own
(0.7 us each), and all are written by plain writes, which tell a full disk as an error where a map would kill.
"""

import os
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from eval.files import drop_stale, replacing

SMALL_BYTES = 256 * 2**20
"""Files up to this are mapped."""


class Stack:
    """An array (frames, height, width, ...) in a file: stack[i] reads a frame, stack[frames, rows, columns] pixels."""

    def __init__(self, path: Path) -> None:
        self.path = path
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
        self.written = 0
        """Frames so far."""

    def __enter__(self) -> Self:
        drop_stale(self._path.parent, f".{self._path.stem}.*")
        header = {"descr": self._dtype.str, "fortran_order": False, "shape": self._shape}
        with ExitStack() as opened:
            temporary = opened.enter_context(replacing(self._path))
            self._file = opened.enter_context(temporary.open("wb"))
            np.lib.format.write_array_header_1_0(self._file, header)
            self._closing = opened.pop_all()
        return self

    def add(self, frame: npt.NDArray[Any] | int) -> None:
        """Append a frame, or one that holds a single value."""
        self._file.write(np.broadcast_to(np.asarray(frame, self._dtype), self._shape[1:]).tobytes())
        self.written += 1

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._closing:  # the file's last bytes are written, then it is renamed
            if error is not None:
                raise error
            if self.written != self._shape[0]:
                raise ValueError(f"{self._path}: {self.written} of {self._shape[0]} frames written")
