"""How long a command says nothing, on a terminal of 80 columns and in a pipe.

python tests/silence.py priors build street --method stereo     prints every silence above SILENT_S, and the lines
"""

import fcntl
import os
import pty
import re
import select
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

SILENT_S = 2.0
"""Work that takes longer says what it does."""
ROWS, COLUMNS = 24, 80
ESCAPES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


@dataclass
class Heard:
    """What a command said, and when."""

    code: int = 0
    seconds: float = 0.0
    text: str = ""
    silences: list[tuple[float, float, str]] = field(default_factory=list)
    """When one began, how long it was, and the last words before it."""

    @property
    def longest_s(self) -> float:
        """The longest silence."""
        return max((length for _, length, _ in self.silences), default=0.0)


def on_terminal(command: Sequence[str], folder: Path, environment: dict[str, str] | None = None) -> Heard:
    """Run a command on a pseudo-terminal and listen."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, COLUMNS, 0, 0))
    known = {**os.environ, "TERM": "xterm-256color", **(environment or {})}
    known.pop("COLUMNS", None)
    began = last = time.monotonic()
    process = subprocess.Popen(command, cwd=folder, env=known, stdin=theirs, stdout=theirs, stderr=theirs)
    os.close(theirs)
    heard, said = Heard(), b""
    while True:
        try:
            part = os.read(ours, 65536) if select.select([ours], [], [], 600)[0] else b""
        except OSError:  # Linux says so when the other end is closed
            part = b""
        now = time.monotonic()
        heard.silences.append((last - began, now - last, _last_words(said)))
        last = now
        if not part:
            break
        said += part
    os.close(ours)
    heard.code, heard.seconds = process.wait(), time.monotonic() - began
    heard.text = ESCAPES.sub("", said.decode(errors="replace"))
    return heard


def _last_words(said: bytes) -> str:
    lines = [line.strip() for line in re.split(r"[\r\n]+", ESCAPES.sub("", said[-2000:].decode(errors="replace")))]
    return next((line for line in reversed(lines) if line), "")


if __name__ == "__main__":
    done = on_terminal(sys.argv[1:], Path.cwd())
    print(done.text.replace("\r", "\n") if os.environ.get("VERBOSE") else "")
    for at, length, words in done.silences:
        if length > SILENT_S:
            print(f"  silent {length:.1f} s from {at:.1f} s on, after {words!r}")
    print(f"  exit {done.code} after {done.seconds:.1f} s, the longest silence {done.longest_s:.1f} s")
