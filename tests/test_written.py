"""What cannot be written is told before any work."""

from pathlib import Path

import pytest

from cli.written import expect_file, expect_folder
from priors.errors import UsageError


def test_what_can_be_written_is_let_through_and_nothing_is_made(tmp_path: Path) -> None:
    (tmp_path / "old.md").write_text("old")
    expect_file("--save", tmp_path / "old.md", [".md"])
    expect_file("--save", tmp_path / "new" / "deep" / "t.md", [".md"])
    expect_folder("--out", tmp_path / "new" / "deep")
    assert [path.name for path in tmp_path.iterdir()] == ["old.md"]
    assert (tmp_path / "old.md").read_text() == "old"


@pytest.mark.parametrize("name", ["file", "file/t.md", "file/a/b/t.md"])
def test_a_file_is_no_folder(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="is a file, not a folder"):
        expect_folder("--out", tmp_path / name)


@pytest.mark.parametrize(
    ("name", "says"), [("t.xls", "ends in .md, .tex"), ("t", "ends in"), ("folder.md", "a folder")]
)
def test_a_name_that_is_none_is_told(tmp_path: Path, name: str, says: str) -> None:
    (tmp_path / "folder.md").mkdir()
    with pytest.raises(UsageError, match=f"--save .*{name}: .*{says}"):
        expect_file("--save", tmp_path / name, [".md", ".tex"])


def test_a_file_system_that_takes_nothing_is_told() -> None:
    if not Path("/proc/self").is_dir():
        pytest.skip("no /proc: the one folder here that nobody can write into")
    with pytest.raises(UsageError, match="/proc/sys cannot be written"):
        expect_file("--save", Path("/proc/sys/new/t.md"))
