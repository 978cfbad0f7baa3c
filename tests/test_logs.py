"""--verbose and --debug: more lines on stderr, the same result on stdout."""

import logging
from collections.abc import Iterator
from pathlib import Path

import pytest

from cli import logs
from cli.priors import PROGRAM


@pytest.fixture(autouse=True)
def as_before() -> Iterator[None]:
    yield
    for name in logs.PACKAGES:
        logging.getLogger(name).handlers.clear()
        logging.getLogger(name).setLevel(logging.NOTSET)


def test_the_flags_are_taken_from_anywhere() -> None:
    assert logs.taken(["build", "--debug", "DATA", "--verbose"]) == ["build", "DATA"]


def test_an_error_has_its_traceback_with_debug_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["check", str(tmp_path / "missing")]
    assert PROGRAM.run(command) == 1
    assert "Traceback" not in capsys.readouterr().err
    assert PROGRAM.run([*command, "--verbose"]) == 1
    assert "Traceback" not in capsys.readouterr().err
    assert PROGRAM.run([*command, "--debug"]) == 1
    said = capsys.readouterr().err
    assert "Traceback" in said and "DataError" in said
    assert said.rstrip().splitlines()[-1].startswith("error: ")


def test_verbose_tells_what_was_opened(street: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["build", str(street), "--method", "lidar", "--frames", "0:1", "--dry-run"]
    assert PROGRAM.run(command) == 0
    quiet = capsys.readouterr()
    assert PROGRAM.run([*command, "--verbose"]) == 0
    told = capsys.readouterr()
    assert told.out == quiet.out
    assert "priors.drives" in told.err and "read as kitti_raw" in told.err.replace("\n", " ")


def test_version_describes_the_machine(capsys: pytest.CaptureFixture[str]) -> None:
    assert PROGRAM.run(["--version"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 1
    assert PROGRAM.run(["--version", "--verbose"]) == 0
    assert "CPU mode" in capsys.readouterr().out
