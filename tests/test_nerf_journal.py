"""metrics.jsonl after kills: no line twice, none of steps that were never kept."""

import json
from pathlib import Path

from nerf import journal


def write(run: Path, *steps: int, tail: str = "") -> None:
    text = "".join(json.dumps({"step": step, "loss": position}) + "\n" for position, step in enumerate(steps))
    (run / journal.NAME).write_text(text + tail)


def steps(run: Path) -> list[int]:
    return [line["step"] for line in journal.read(run)]


def test_a_later_line_replaces_what_it_repeats(tmp_path: Path) -> None:
    write(tmp_path, 20, 40, 60, 40, 60, 80)
    assert steps(tmp_path) == [20, 40, 60, 80]
    assert journal.read(tmp_path)[1]["loss"] == 3


def test_what_was_cut_off_or_is_no_line_is_left_out(tmp_path: Path) -> None:
    write(tmp_path, 20, 40, tail='{"step": 60, "lo')
    assert steps(tmp_path) == [20, 40]
    (tmp_path / journal.NAME).write_bytes(b'\xff\xfe\n[1]\n{"loss": 1}\n{"step": 7}\n')
    assert steps(tmp_path) == [7]
    assert journal.read(tmp_path / "none") == []


def test_lines_after_the_checkpoint_are_dropped(tmp_path: Path) -> None:
    write(tmp_path, 20, 40, 60, tail='{"step": 80, "lo')
    journal.cut(tmp_path, 45)
    assert [json.loads(line)["step"] for line in (tmp_path / journal.NAME).read_text().splitlines()] == [20, 40]
    journal.cut(tmp_path, 0)
    assert (tmp_path / journal.NAME).read_text() == ""
    journal.cut(tmp_path / "none", 0)
    assert not (tmp_path / "none").exists()
