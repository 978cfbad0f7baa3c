"""`priors eval` in a cache of two drives: one file for all, and what cannot be read or written costs its own place."""

import csv
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from factories import write_folder

from cli.console import guarded
from cli.priors import eval as command
from cli.priors import report
from priors import cache
from priors.cache import Prior
from priors.drives import open_drive
from priors.types import Depth

IDS = ("a", "b", "c")
ROWS = ["lidar", "stereo", "mono"]
Run = Callable[..., tuple[int, str, str]]


def make(folder: Path, method: str, factor: float) -> Prior:
    """A prior in cache/ that is off by a factor everywhere, of the drive in a folder."""
    drive = open_drive(folder)
    manifest = {"format": cache.FORMAT, "method": method, "key": f"{method}0000000000", "config": {}, "filters": {}}
    manifest |= {"drive": {"name": drive.name, **drive.describe()}, "fingerprint": drive.fingerprint()}
    prior = cache.create(Path("cache") / drive.name / f"{method}-0000000000", manifest)
    for frame in (drive[index] for index in range(len(drive))):
        prior.write(frame.id, Depth(frame.truth().depth_m * np.float32(factor)), 0.1)
    return prior


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with cache/: two priors of one drive and one of another."""
    monkeypatch.chdir(tmp_path)
    for name, ids, methods in (("one", IDS, ("lidar", "stereo")), ("two", IDS[:2], ("mono",))):
        write_folder(tmp_path / name, ids)
        for method in methods:
            make(tmp_path / name, method, {"lidar": 1.1, "stereo": 1.2, "mono": 1.3}[method])
    return tmp_path


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Run `priors eval`; returns exit code, output and errors."""

    def call(*arguments: str, what: object = command) -> tuple[int, str, str]:
        code = guarded(lambda: what.run(list(arguments)))  # type: ignore[attr-defined]
        done = capsys.readouterr()
        return code, done.out, done.err

    return call


def map_of(method: str, id_: str = "b") -> Path:
    return next(Path("cache").glob(f"*/{method}-*/depth/{id_}.png"))


def rows(text: str) -> list[str]:
    """The rows of the tables that were printed, without figures."""
    return re.findall(r"^(lidar|stereo|mono) +[\d.]+ ", text, re.MULTILINE)


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:60])


def test_a_prior_none_of_whose_maps_can_be_read_costs_its_row(run: Run) -> None:
    assert rows(run()[1]) == ROWS
    for id_ in IDS:
        cut(map_of("stereo", id_))
    code, out, err = run("--save", "t.md")
    assert code == 1 and rows(out) == ["lidar", "mono"]
    assert err.count("left out: stereo: ") == 1
    assert "| mono |" in Path("t.md").read_text()


def test_a_drive_that_is_gone_costs_its_table(run: Run) -> None:
    shutil.rmtree("one")
    code, out, err = run("--save", "t.md")
    assert code == 1 and rows(out) == ["mono"] and "cache/one: " in err
    text = Path("t.md").read_text()
    assert "mono" in text and "lidar" not in text
    shutil.rmtree("two")
    code, out, _ = run("--save", "none.md")
    assert code == 1 and not rows(out) and not Path("none.md").exists()


def test_one_file_holds_the_tables_of_all_drives(run: Run) -> None:
    names = [f"new/t{suffix}" for suffix in (".md", ".tex", ".txt", ".csv", ".html")]
    code, out, _ = run("--save", *names, "--metrics", "abs_rel", "delta_1")
    assert code == 0 and all(f"wrote {name}" in out for name in names)
    assert sorted(path.name for path in Path("new").iterdir()) == sorted(Path(name).name for name in names)
    text = Path("new/t.md").read_text()
    assert text.index("## one") < text.index("| lidar |") < text.index("## two") < text.index("| mono |")
    assert "| prior | AbsRel ↓ | δ<1.25 ↑ |" in text
    assert Path("new/t.tex").read_text().count(r"\end{tabular}") == 2
    page = Path("new/t.html").read_text()
    assert "Depth priors of one, two" in page and page.index(">lidar<") < page.index(">mono<")
    with Path("new/t.csv").open() as file:
        found = [(row["drive"], row["prior"]) for row in csv.DictReader(file) if row["pooling"] == "image"]
    assert found == [("one", "lidar"), ("one", "stereo"), ("two", "mono")]
    run("cache/two", "--save", "alone.md")
    assert Path("alone.md").read_text().startswith("| prior"), "the table of one drive needs no heading"


def test_results_that_were_made_before_are_tables_of_their_drives(run: Run) -> None:
    run()
    files = sorted(str(path) for path in Path("cache").glob("*/*/metrics.json"))
    code, out, _ = run(*files, "--save", "t.md")
    assert code == 0 and rows(out) == ROWS
    assert [line for line in out.splitlines() if line in ("one", "two")] == ["one", "two"]
    assert Path("t.md").read_text().count("## ") == 2


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (("--save", "t.xls"), "expected a name that ends in .md"),
        (("--save", "folder.md"), "is a folder: name a file in it"),
        (("--save", "t.md", "file/t.md"), "file/t.md: "),
        (("--curves", "file/new/c.svg"), "is a file, not a folder"),
        (("--metrics", "abs_rell"), "did you mean abs_rel?"),
        (("--metrics", "best"), "expected some of density, "),
    ],
)
def test_what_cannot_be_is_told_before_anything_is_scored(run: Run, flags: tuple[str, ...], says: str) -> None:
    Path("folder.md").mkdir()
    Path("file").touch()
    code, out, err = run(*flags)
    assert (code, out) == (2, "") and says in err and len(err.splitlines()) == 1


@pytest.mark.parametrize("what", [command, report])
def test_frames_that_the_drive_does_not_have_are_told_once(run: Run, what: object) -> None:
    code, out, err = run("cache/one", "--frames", "7:9", what=what)
    assert (code, out, err.count("--frames 7:9")) == (2, "", 1) and "the drive has 0:3" in err


def test_columns_are_named_as_tables_print_them_too(run: Run) -> None:
    code, out, _ = run("--metrics", "AbsRel", "delta-1", "D1")
    assert code == 0 and "AbsRel ↓  δ<1.25 ↑  D1 % ↓" in out
