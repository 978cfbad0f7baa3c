"""Claims: one owner at a time, dead ones are anybody's, a launch is one owner."""

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from priors.errors import DataError
from priors.owner import claim, process
from priors.owner.claim import DEAD_S, Claim, hold, is_dead, owner_of, take


@pytest.fixture(autouse=True)
def fresh() -> Iterator[None]:
    """What this process is depends on its environment: asked anew in each test."""
    process.me.cache_clear()
    yield
    process.me.cache_clear()


def taken(path: Path) -> Claim:
    held = take(path)
    assert held is not None
    return held


def written(path: Path, **changed: object) -> Path:
    """A claim's file as another process would have it."""
    record = {"token": "theirs", **process.me(os.getpid()).record(), **changed}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(record))
    return path


def elsewhere(path: Path, silent_s: float = 0.0) -> Path:
    """A claim of another host, last touched so long ago."""
    written(path, host="elsewhere", pid=1)
    os.utime(path, (time.time() - silent_s,) * 2)
    return path


def other_process(path: Path, *then: str) -> subprocess.Popen[str]:
    """A process that takes the claim, says so, and goes on to `then`; by default it waits to be killed."""
    code = ["import sys, time", "from pathlib import Path", "from priors.owner.claim import take"]
    code += ["held = take(Path(sys.argv[1]), by_launch=True)", "print(held is not None, flush=True)"]
    code += then or ["time.sleep(60)"]
    return subprocess.Popen([sys.executable, "-c", "\n".join(code), str(path)], stdout=subprocess.PIPE, text=True)


def said(other: subprocess.Popen[str]) -> str:
    assert other.stdout is not None
    return other.stdout.readline().strip()


def test_a_claim_is_one_owner_s_until_it_is_given_back(tmp_path: Path) -> None:
    path = tmp_path / "claims" / "5"
    first = taken(path)
    assert take(path) is None, "not even by the same process twice"
    assert take(tmp_path / "claims" / "6") is not None
    first.release()
    assert not path.exists()
    taken(path).release()
    assert sorted(file.name for file in path.parent.iterdir()) == ["6"], "nothing else is left"


def test_who_is_refused_is_told_who_has_it(tmp_path: Path) -> None:
    with (
        hold(tmp_path / ".owner", "runs/a"),
        pytest.raises(DataError, match=rf"runs/a: process {os.getpid()} on .*wait for it, or stop it"),
        hold(tmp_path / ".owner", "runs/a"),
    ):
        pass
    assert not (tmp_path / ".owner").exists()


def test_a_killed_process_loses_its_claim_at_once(tmp_path: Path) -> None:
    path = tmp_path / "5"
    other = other_process(path)
    try:
        assert said(other) == "True"
        assert take(path) is None
        assert owner_of(path) is not None
        other.kill()
        while not is_dead(path):  # it has ended, and nobody has asked for its exit code: a zombie
            time.sleep(0.01)
        taken(path).release()
    finally:
        other.kill()
        other.communicate()


def test_a_number_that_was_given_out_again_is_another_process(tmp_path: Path) -> None:
    assert owner_of(written(tmp_path / "5", pid=os.getppid(), started="1")) is None
    assert owner_of(written(tmp_path / "6", pid=os.getppid(), started="")) is not None, "where that is not known"


def test_another_host_is_judged_by_its_heartbeat(tmp_path: Path) -> None:
    assert take(elsewhere(tmp_path / "5", DEAD_S - 5)) is None
    assert take(elsewhere(tmp_path / "6", DEAD_S + 5)) is not None
    assert take(elsewhere(tmp_path / "7", -DEAD_S - 5)) is not None, "touched in the future: a clock was wrong"


def test_what_is_held_is_touched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(claim, "BEAT_S", 0.01)
    monkeypatch.setattr(claim, "_beating", None)  # an earlier test's thread sleeps for longer
    with taken(tmp_path / "5") as held:
        os.utime(held.path, (0, 0))
        while held.path.stat().st_mtime == 0:  # hangs where the heart does not beat
            time.sleep(0.01)
        assert not held.lost


@pytest.mark.parametrize("thief", ["another", "nobody"])
def test_who_stood_still_too_long_finds_its_claim_lost(tmp_path: Path, thief: str) -> None:
    held = taken(tmp_path / "5")
    held.path.unlink()
    if thief == "another":
        elsewhere(held.path)
    held.beat()
    assert held.lost
    held.release()
    assert held.path.exists() == (thief == "another"), "what is another's is left alone"


@pytest.mark.parametrize("text", ["", "{", "[]", '{"token": 5}', '{"token": "a", "pid": 1, "ticket": 7}'])
def test_a_claim_that_cannot_be_read_lives_as_long_as_it_is_touched(tmp_path: Path, text: str) -> None:
    path = tmp_path / "5"
    path.write_text(text)
    assert take(path) is None
    os.utime(path, (0, 0))
    assert is_dead(path)
    taken(path).release()


def test_processes_of_one_launch_are_one_owner(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WORLD_SIZE", "2")
    monkeypatch.setenv("MASTER_ADDR", "localhost")
    monkeypatch.setenv("MASTER_PORT", "29500")
    process.me.cache_clear()
    path = tmp_path / ".owner"
    first = taken(path)
    other = other_process(path, "held.release()")
    assert said(other) == "True", "a process of the same launch"
    assert other.wait() == 0
    assert path.exists(), "it is given back by the one that made it"
    monkeypatch.setenv("MASTER_PORT", "29501")
    stranger = other_process(path, "pass")
    assert said(stranger) == "False"
    stranger.communicate()
    first.beat()
    assert not first.lost
    first.release()


def test_of_many_who_see_a_dead_claim_one_gets_it(tmp_path: Path) -> None:
    for number in range(20):
        path = elsewhere(tmp_path / str(number), 2 * DEAD_S)
        start, got = threading.Barrier(6), []

        def race(path: Path = path, start: threading.Barrier = start, got: list[Claim] = got) -> None:
            start.wait()
            if held := take(path):
                got.append(held)

        threads = [threading.Thread(target=race) for _ in range(6)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(got) == 1
        got[0].release()


def test_a_file_system_without_hard_links(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", none)
    held = taken(tmp_path / "5")
    assert take(tmp_path / "5") is None
    held.release()


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "claims").write_text("a file")
    with pytest.raises(OSError, match="claims"):
        take(tmp_path / "claims" / "5")


def test_a_folder_that_another_process_deletes_just_now_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`mkdir` finds it there, and it is gone when that is looked at: a frame in ten thousand failed by this."""
    real, calls = os.mkdir, []

    def mkdir(path: Path, mode: int = 0o777) -> None:
        calls.append(path)
        if len(calls) == 1:
            raise FileExistsError(17, "File exists", str(path))
        real(path, mode)

    monkeypatch.setattr(os, "mkdir", mkdir)
    with taken(tmp_path / "claims" / "frame") as held:
        assert held.path.exists() and len(calls) == 2


def test_a_file_where_the_folder_should_be_is_named(tmp_path: Path) -> None:
    (tmp_path / "claims").write_text("no folder")
    with pytest.raises(OSError, match="claims"):
        take(tmp_path / "claims" / "frame")
