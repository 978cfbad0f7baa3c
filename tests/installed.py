"""The installed `priors`, run as a user runs it."""

import subprocess
import sys
from pathlib import Path

PRIORS = Path(sys.executable).parent / "priors"


def priors(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [str(PRIORS), *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=300)


def succeed(*arguments: object, cwd: Path) -> str:
    done = priors(*arguments, cwd=cwd)
    assert done.returncode == 0, done.stderr
    return done.stdout


def fail(*arguments: object, cwd: Path, code: int = 1) -> str:
    """Run what must fail; returns the error, which is one line without a traceback."""
    done = priors(*arguments, cwd=cwd)
    assert done.returncode == code, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    errors = [line for line in done.stderr.splitlines() if line.startswith("error:")]
    assert len(errors) <= 1
    return errors[0] if errors else done.stderr


def stamps(folder: Path) -> dict[str, int]:
    """When each depth map of a cache was written."""
    return {str(path): path.stat().st_mtime_ns for path in folder.rglob("depth/[!.]*.png")}
