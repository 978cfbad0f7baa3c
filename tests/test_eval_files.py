"""Atomic writes: a reader finds the old file or the whole new one, whatever stops the writer."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from conftest import FullDisk

from eval.files import STALE_S, drop_stale, replacing, write_atomically, write_bytes


def test_the_folder_is_made_and_the_suffix_stays(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "a.png"
    with replacing(path) as temporary:
        assert temporary.suffix == ".png" and temporary.parent == path.parent
        temporary.write_bytes(b"new")
        assert not path.exists()
    assert path.read_bytes() == b"new"
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt])
def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path, error: type[BaseException]) -> None:
    path = tmp_path / "a.png"
    write_bytes(path, b"old")

    def fail(temporary: Path) -> None:
        temporary.write_bytes(b"half")
        raise error

    with pytest.raises(error):
        write_atomically(path, fail)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_s_error_names_the_file(tmp_path: Path, full_disk: FullDisk) -> None:
    path = tmp_path / "a.bin"
    with full_disk(50_000), pytest.raises(OSError) as told:
        write_bytes(path, bytes(100_000))
    assert told.value.filename == str(path) and told.value.strerror
    assert not list(tmp_path.iterdir())


def test_an_error_of_another_file_keeps_its_name(tmp_path: Path) -> None:
    missing = tmp_path / "missing"
    with pytest.raises(FileNotFoundError) as told, replacing(tmp_path / "a.bin") as temporary:
        temporary.write_bytes(missing.read_bytes())
    assert told.value.filename == str(missing)


def test_a_folder_that_cannot_be_written_is_an_error_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "a.bin").mkdir()
    with pytest.raises(OSError) as told:
        write_bytes(tmp_path / "a.bin", b"new")
    assert told.value.filename == str(tmp_path / "a.bin")
    assert [path.name for path in tmp_path.iterdir()] == ["a.bin"]


def test_a_kill_in_the_middle_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    write_bytes(path, b"old")
    program = (
        "import os, signal, sys; from pathlib import Path; from eval.files import replacing\n"
        "with replacing(Path(sys.argv[1])) as path: path.write_bytes(b'half'); os.kill(os.getpid(), signal.SIGKILL)"
    )
    assert subprocess.run([sys.executable, "-c", program, str(path)], check=False).returncode < 0
    assert path.read_bytes() == b"old"
    # What the kill leaves is a hidden file that no reader takes for a map; the next write is not in its way.
    assert all(left.name.startswith(".") for left in tmp_path.iterdir() if left != path)
    write_bytes(path, b"new")
    assert path.read_bytes() == b"new"


def test_what_a_kill_left_is_dropped_once_it_is_old(tmp_path: Path) -> None:
    paths = [tmp_path / "deep" / name for name in (".a.1.png", ".a.2.png", ".b.3.png", "a.png")]
    paths[0].parent.mkdir()
    for path in paths:
        path.write_bytes(b"half")
    for path in (paths[0], paths[2], paths[3]):
        os.utime(path, (0, time.time() - 2 * STALE_S))
    drop_stale(tmp_path, ".a.*")
    assert [path.exists() for path in paths] == [False, True, True, True]
    drop_stale(tmp_path)
    assert [path.exists() for path in paths] == [False, True, False, True]
