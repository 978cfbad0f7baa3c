"""What a command says while it works: on a terminal and in a pipe."""

import io
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from silence import on_terminal

from cli import console
from cli.console import busy, fit_progress, progress, train_progress
from cli.terminal import Screen


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], list[str]]]:
    """What stands on stderr, a pipe; what is soon done is after 0.02 s."""
    stream = io.StringIO()
    monkeypatch.setattr(console, "err", Screen(file=stream, width=80))
    monkeypatch.setattr(console, "SILENT_S", 0.02)
    yield lambda: stream.getvalue().splitlines()


def test_what_is_soon_done_is_not_told(told: Callable[[], list[str]]) -> None:
    with busy("thinking"):
        pass
    time.sleep(0.05)
    assert told() == []


def test_what_takes_longer_is_told_before_and_after(told: Callable[[], list[str]]) -> None:
    with busy("thinking"):
        while not told():
            time.sleep(0.01)
        assert told() == ["thinking ..."]
    assert told() == ["thinking ...", "thinking: 0 s"]


def test_an_error_ends_it(told: Callable[[], list[str]]) -> None:
    with pytest.raises(ValueError, match="no"), busy("thinking"):
        raise ValueError("no")
    time.sleep(0.05)
    assert told() == []


@pytest.mark.parametrize("total", [3, 10, 999])
def test_a_pipe_gets_a_line_a_tenth(told: Callable[[], list[str]], total: int) -> None:
    with progress("maps", total) as step:
        time.sleep(0.03)
        for _ in range(total):
            step()
    assert len(told()) == min(total, 10) and told()[-1] == f"maps {total}/{total}"


@pytest.mark.parametrize("first", [0, 700])
def test_a_pipe_gets_a_line_a_tenth_of_a_fit(told: Callable[[], list[str]], first: int) -> None:
    """One that goes on at 70 % tells what is left."""
    with fit_progress("fit") as step:
        for i in range(first + 1, 1001):
            step(SimpleNamespace(progress=i / 1000, rays=1, step_s=1.0, psnr=20.0, loss=0.1, step=i, elapsed_s=i))
    assert len(told()) == (1000 - first) // 100
    assert told()[-1].startswith("fit 100%: PSNR 20.0 dB")


def test_a_pipe_gets_a_line_a_tenth_of_a_training(told: Callable[[], list[str]]) -> None:
    with train_progress("run") as step:
        for i in range(1, 501):
            step(SimpleNamespace(done=i / 500, step=i, values={"loss": 0.5}))
    assert len(told()) == 10 and told()[-1] == "run 100%: step 500, loss 0.5"


SLEEPY = """\
import time
from cli.console import busy, err
with busy("thinking hard"):
    time.sleep(1.5)
err.print("done")
"""


def test_a_terminal_shows_it_while_it_lasts(tmp_path: Path) -> None:
    heard = on_terminal([sys.executable, "-c", SLEEPY], tmp_path)
    assert heard.code == 0 and "thinking hard" in heard.text
    assert heard.text.strip().endswith("done")
    assert sum("thinking" in words for _, _, words in heard.silences) > 3, "it moves"
