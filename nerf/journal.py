"""Journal: metrics.jsonl, a line every so many steps, written as training goes and read back for curves.

A fit that goes on from a checkpoint first drops what a killed fit wrote after it: those steps are made again.
"""

import json
from pathlib import Path
from typing import Any

from eval.files import write_bytes

NAME = "metrics.jsonl"


def read(run: Path) -> list[dict[str, Any]]:
    """Return a run's lines, in the order of their steps; a line that was written later replaces those it repeats.

    What a kill cut off, and what is no line of a journal, is left out.
    """
    path, lines = run / NAME, list[dict[str, Any]]()
    for text in path.read_text(encoding="utf-8", errors="replace").splitlines() if path.exists() else []:
        try:
            line = json.loads(text)
            step = int(line["step"])
        except (ValueError, KeyError, TypeError):
            continue
        while lines and lines[-1]["step"] >= step:
            lines.pop()
        lines.append(line)
    return lines


def cut(run: Path, step: int) -> None:
    """Drop the lines of steps after `step`, and those that are damaged or repeated."""
    path = run / NAME
    if path.exists():
        kept = [line for line in read(run) if line["step"] <= step]
        text = "".join(json.dumps(line) + "\n" for line in kept)
        if text.encode() != path.read_bytes():
            write_bytes(path, text.encode())
