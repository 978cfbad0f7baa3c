"""Runs the parts one after the other, stops what runs over, and writes down what is known as soon as it is known."""

import contextlib
import json
import os
import shlex
import signal
import subprocess
import sys
import threading
import time
from argparse import Namespace
from collections import deque
from pathlib import Path
from typing import IO, Any

from eval.files import write_bytes
from tests.bench.gpu.parts import PARTS, Part, find
from tests.bench.gpu.summary import markdown

GRACE_S = 5.0
"""Between asking a part to stop and killing it."""
LAST_LINES = 12
"""Of a part that failed, in the summary."""
LOG_BYTES = 4 << 20
"""The log is cut here: what comes back must stay small."""


class Book:
    """results.json, summary.md and log.txt; results and summary are whole at any time."""

    def __init__(self, out: Path, record: dict[str, Any]) -> None:
        out.mkdir(parents=True, exist_ok=True)
        self.out, self.record = out, record
        self._log = (out / "log.txt").open("w")
        self._lock = threading.Lock()

    def write(self) -> None:
        """Write what is known."""
        with self._lock:
            for name, text in (
                ("results.json", json.dumps(self.record, indent=1) + "\n"),
                ("summary.md", markdown(self.record)),
            ):
                write_bytes(self.out / name, text.encode())

    def log(self, line: str) -> None:
        """Keep a line that a part printed."""
        if line.strip() and self._log.tell() < LOG_BYTES:
            self._log.write(line)
            self._log.flush()


def run(options: Namespace) -> int:
    """Run the chosen parts; returns 1 where one failed, else 0."""
    chosen = [find(name) for name in options.parts] if options.parts else list(PARTS)
    if find("machine") not in chosen:
        chosen.insert(0, find("machine"))
    whole = sum(part.seconds for part in chosen)
    budget = whole if options.budget is None else options.budget
    options.scale = min(1.0, budget / whole)
    started = time.perf_counter()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that the running part is ended as well
    record = {
        "device": options.device,
        "began": time.strftime("%Y-%m-%d %H:%M:%S"),
        "commit": _commit(),
        "budget_s": budget,
        "parts": {},
    }
    book = Book(options.out, record)
    for part in chosen:
        left = budget - (time.perf_counter() - started)
        limit = left if part is chosen[-1] else min(left, _share_s(part, budget / whole))
        entry = record["parts"][part.name] = {"budget_s": round(limit, 1), "state": "running", "figures": {}}
        book.write()
        why = _obstacle(part, record, options.device, limit)
        if why:
            entry |= {"state": "left out", "error": [why], "seconds": 0.0}
        else:
            _run_part(part, options, limit, entry, book)
        book.write()
        print(f"{part.name:8} {entry['state']:9} {entry['seconds']:6.1f} s of {limit:.0f}  {why}".rstrip(), flush=True)
    print((options.out / "summary.md").read_text())
    return int(any(entry["state"] in ("failed", "left out") for entry in record["parts"].values()))


def _share_s(part: Part, scale: float) -> float:
    """Return a part's seconds; the first one is needed by all others and is not scaled. The last gets what is left."""
    return part.seconds if part.name == "machine" else part.seconds * scale


def _obstacle(part: Part, record: dict[str, Any], device: str, left_s: float) -> str:
    """Return in one line why a part cannot run; nothing where it can."""
    machine = record["parts"]["machine"]
    if part.name == "machine":
        return ""
    if device == "cuda" and "capability" not in machine["figures"]:
        return "there is no GPU to run on: see the part `machine`"
    found = machine["figures"].get("modules", {})
    missing = [name for name in part.needs if found.get(name) is None]
    if missing:
        return f"missing here: {', '.join(missing)}: bring them as wheels (docs/gpu.md)"
    return "" if left_s >= 1 else "no time is left"


def _run_part(part: Part, options: Namespace, limit: float, entry: dict[str, Any], book: Book) -> None:
    """Run a part as a process of its own and fill its entry."""
    start = time.perf_counter()
    command = [sys.executable, str(Path(__file__).with_name("__main__.py")), "--part", part.name]
    command += ["--pack", str(options.pack), "--out", str(options.out), "--device", options.device]
    command += ["--deadline", f"{time.time() + limit:.1f}", "--scale", f"{options.scale:.4f}"]
    command += ["--crops", str(options.crops), "--runs", str(options.runs), "--networks", *options.networks]
    command += ["--train", options.train] if options.train else []
    command += ["--train-s", str(options.train_s)] if options.train_s else []
    environment = os.environ | {"PYTHONUNBUFFERED": "1"}
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, [str(_root()), os.environ.get("PYTHONPATH")]))
    book.log(f"$ {shlex.join(command)}\n")
    with subprocess.Popen(
        command,
        cwd=_root(),
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        start_new_session=True,  # so that its children end with it
    ) as process:
        last: deque[str] = deque(maxlen=LAST_LINES)
        reader = threading.Thread(target=_read, args=(process.stdout, entry, last, book), daemon=True)
        reader.start()
        try:
            code = process.wait(limit)
            entry["state"] = "failed" if code else "done"
        except subprocess.TimeoutExpired:
            entry["state"] = "cut"
        finally:  # also where this process is told to stop
            _end(process)
        reader.join(GRACE_S)
    entry["seconds"] = round(time.perf_counter() - start, 1)
    if entry["state"] == "failed":
        entry["error"] = list(last) or [f"ended with code {code} and said nothing"]


def _read(lines: IO[str], entry: dict[str, Any], last: deque[str], book: Book) -> None:
    """Keep figures and log of what a part prints, line by line."""
    for line in lines:
        book.log(line)
        try:
            found = json.loads(line) if line.startswith("{") else None
        except ValueError:
            found = None
        if isinstance(found, dict):
            entry["figures"] |= found
            book.write()
        elif line.strip():
            last.append(line.rstrip()[:300])


def _end(process: subprocess.Popen[str]) -> None:
    """End a part with all its children."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGTERM)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(GRACE_S)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


def _root() -> Path:
    return Path(__file__).resolve().parents[3]


def _commit() -> str:
    """Return the checkout's commit; a copy without git has none."""
    command = ["git", "-C", str(_root()), "rev-parse", "--short", "HEAD"]
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=10, check=False).stdout.strip()
    except (OSError, subprocess.TimeoutExpired):
        return ""
