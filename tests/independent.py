"""Parsers of other programs, in an environment of their own: `make parsers` makes it and names it by PARSERS."""

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest

PARSERS = "ROADPRIOR_PARSERS"
"""Names the environment's Python."""


def parse(script: str, *arguments: object) -> dict[str, Any]:
    """Run a script of tests/parsers with arguments; returns the JSON that it prints. Skips where there is none."""
    python = os.environ.get(PARSERS)
    if not python:
        pytest.skip(f"no independent parsers: {PARSERS} is not set (make parsers)")
    path = Path(__file__).parent / "parsers" / script
    done = subprocess.run([python, path, *map(str, arguments)], capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])
