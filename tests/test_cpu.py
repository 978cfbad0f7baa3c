"""CPU modes: which there are here, how one is asked for, and how a wrong one is told."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import pytest

from priors.errors import DataError
from priors.machine import cpu

ROOT = Path(__file__).resolve().parents[1]
AVX512 = {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}
AVX2 = {"avx2", "fma", "f16c", "bmi2"}


@pytest.fixture(autouse=True)
def fresh(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Nothing is asked for, and nothing remembered from before."""
    monkeypatch.delenv(cpu.VARIABLE, raising=False)
    for name in {name for held in cpu._HELD.values() for name in held}:
        monkeypatch.delenv(name, raising=False)
    cpu.mode.cache_clear()
    cpu.supported.cache_clear()
    yield
    cpu.mode.cache_clear()
    cpu.supported.cache_clear()


def pretend(monkeypatch: pytest.MonkeyPatch, features: set[str], x86: bool = True, tiles: bool = True) -> None:
    monkeypatch.setattr(cpu, "features", lambda: frozenset(features))
    monkeypatch.setattr(cpu, "_is_x86", lambda: x86)
    monkeypatch.setattr(cpu, "_may_use_tiles", lambda: tiles)


@pytest.mark.parametrize(
    ("features", "modes"),
    [
        (set(), ("plain", "amx_emulated")),
        (AVX2, ("avx2", "plain", "amx_emulated")),
        (AVX2 - {"fma"}, ("plain", "amx_emulated")),
        (AVX2 | AVX512, ("avx512", "avx2", "plain", "amx_emulated")),
        (AVX2 | AVX512 | {"avx512bf16"}, ("avx512_bf16", "avx512", "avx2", "plain", "amx_emulated")),
        (
            AVX2 | AVX512 | {"avx512bf16", "amx-tile", "amx-bf16"},
            ("amx", "avx512_bf16", "avx512", "avx2", "plain", "amx_emulated"),
        ),
    ],
)
def test_the_fastest_mode_that_the_cpu_has_is_taken(
    monkeypatch: pytest.MonkeyPatch, features: set[str], modes: tuple[str, ...]
) -> None:
    pretend(monkeypatch, features)
    assert cpu.supported() == modes
    assert cpu.mode() == modes[0]


def test_tiles_need_the_operating_systems_leave(monkeypatch: pytest.MonkeyPatch) -> None:
    pretend(monkeypatch, AVX2 | AVX512 | {"avx512bf16", "amx-tile", "amx-bf16"}, tiles=False)
    assert cpu.mode() == "avx512_bf16"


def test_other_processors_have_one_mode(monkeypatch: pytest.MonkeyPatch) -> None:
    pretend(monkeypatch, {"neon"}, x86=False)
    assert cpu.supported() == ("plain", "amx_emulated")
    monkeypatch.setenv(cpu.VARIABLE, "plain")
    cpu.hold_down()
    assert "NUMBA_CPU_NAME" not in os.environ


def test_this_cpu_has_a_mode() -> None:
    assert cpu.mode() == cpu.supported()[0]
    assert set(cpu.supported()) <= set(get_args(cpu.Mode))


def test_what_is_asked_for_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    pretend(monkeypatch, AVX2 | AVX512)
    monkeypatch.setenv(cpu.VARIABLE, "avx2")
    assert cpu.mode() == "avx2"


@pytest.mark.parametrize(("asked", "told"), [("foo", "expected one of amx, "), ("amx", "this CPU has not got it")])
def test_a_wrong_mode_is_told(monkeypatch: pytest.MonkeyPatch, asked: str, told: str) -> None:
    pretend(monkeypatch, AVX2)
    monkeypatch.setenv(cpu.VARIABLE, asked)
    with pytest.raises(DataError, match=f"ROADPRIOR_CPU={asked}: {told}"):
        cpu.mode()


@pytest.mark.parametrize("mode", list(cpu._HELD))
def test_holding_down_tells_the_libraries(monkeypatch: pytest.MonkeyPatch, mode: cpu.Mode) -> None:
    monkeypatch.setattr(cpu, "_is_x86", lambda: True)
    monkeypatch.setitem(os.environ, cpu.VARIABLE, mode)
    monkeypatch.setenv("ONEDNN_MAX_CPU_ISA", "mine")
    monkeypatch.delitem(sys.modules, "numba", raising=False)  # this process is not to be held down
    for name in cpu._HELD[mode]:
        monkeypatch.setenv(name, os.environ.get(name, ""))  # taken back after the test
        if name != "ONEDNN_MAX_CPU_ISA":
            os.environ.pop(name)
    cpu.hold_down()
    expected = {**cpu._HELD[mode], "ONEDNN_MAX_CPU_ISA": "mine"}
    assert {name: os.environ[name] for name in cpu._HELD[mode]} == expected


def test_nothing_is_held_down_unasked(monkeypatch: pytest.MonkeyPatch) -> None:
    before = dict(os.environ)
    cpu.hold_down()
    assert dict(os.environ) == before


def command(mode: str, *words: str) -> subprocess.CompletedProcess[str]:
    code = f"from cli.{words[0]} import main; main()"
    environment = {**os.environ, cpu.VARIABLE: mode}
    return subprocess.run(
        [sys.executable, "-c", code, *words[1:]], env=environment, cwd=ROOT, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize(
    "words", [("priors", "build", "x", "--method", "stereo"), ("priors", "list"), ("nerf", "fit", "x")], ids=" ".join
)
def test_every_command_refuses_a_wrong_mode_in_one_line(words: tuple[str, ...]) -> None:
    done = command("foo", *words)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr == f"error: ROADPRIOR_CPU=foo: expected one of {', '.join(get_args(cpu.Mode))}\n"


@pytest.mark.skipif("amx" in cpu.supported(), reason="this CPU has tiles")
def test_every_command_refuses_a_mode_that_this_cpu_lacks() -> None:
    done = command("amx", "priors", "list")
    assert done.returncode == 2
    assert done.stderr.startswith("error: ROADPRIOR_CPU=amx: this CPU has not got it: choose one of ")
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    "words", [("priors", "--help"), ("priors", "build", "--help"), ("nerf", "--help")], ids=" ".join
)
def test_help_does_not_ask(words: tuple[str, ...]) -> None:
    done = command("foo", *words)
    assert done.returncode == 0
    assert not done.stderr
