"""tests/triton_checks.py and triton_splat_checks.py, on the GPU or in Triton's interpreter.

Every test is noted when it ends.
"""

import os
import time
from argparse import Namespace
from pathlib import Path

from tests.bench.gpu.parts import note

CHECKS = [Path(__file__).resolve().parents[2] / name for name in ("triton_checks.py", "triton_splat_checks.py")]
FEW = "adam or stay_on_their_device or (test_encoding and points)"
"""For a rehearsal: the interpreter is slow."""


class Noted:
    """A plugin of pytest that notes what passed and what failed as it goes."""

    def __init__(self) -> None:
        self.start = time.perf_counter()
        self.passed = 0
        self.failed: dict[str, str] = {}
        self.slowest = ("", 0.0)

    def pytest_runtest_logreport(self, report: object) -> None:
        name = report.nodeid.partition("::")[2]  # type: ignore[attr-defined]
        if report.failed:  # type: ignore[attr-defined]
            lines = str(report.longrepr).splitlines()  # type: ignore[attr-defined]
            wrong = [line[2:].strip() for line in lines if line.startswith("E ")]
            self.failed[name] = " / ".join(wrong[:6])[:500] or lines[-1][:500]
        elif report.when == "call" and report.passed:  # type: ignore[attr-defined]
            self.passed += 1
            self.slowest = max(self.slowest, (name, round(report.duration, 1)), key=lambda x: x[1])  # type: ignore[attr-defined]
        else:
            return
        seconds = round(time.perf_counter() - self.start, 1)
        note(passed=self.passed, failed=self.failed, slowest=f"{self.slowest[0]} {self.slowest[1]} s", seconds=seconds)


def run(options: Namespace) -> None:
    """Run the checks; raise SystemExit where one fails."""
    if options.device == "cpu":
        os.environ["TRITON_INTERPRET"] = "1"  # before Triton is imported
    import pytest

    note(where="Triton's interpreter" if options.device == "cpu" else "GPU")
    arguments = ["-q", "-p", "no:cacheprovider", "--tb=short", *map(str, CHECKS)]
    if options.device == "cpu" and options.scale < 1:
        note(left_out=f"all but `{FEW}`: the budget is short")
        arguments += ["-k", FEW]
    if code := pytest.main(arguments, plugins=[Noted()]):
        raise SystemExit(f"pytest ends with code {int(code)}: a kernel differs from its twin, or does not run")
