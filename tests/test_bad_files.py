"""A missing, empty or foreign file of any data set: one line that says which file and what to do, and others go on."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from test_datasets_table import WRITERS

from priors.drives import DriveOptions, open_drive
from priors.errors import DataError
from priors.types import Input

pytestmark = pytest.mark.datasets
INPUTS: tuple[Input, ...] = ("image", "other", "sweep", "truth", "sparse")
MEND = re.compile(
    r"\b(download|put|write|unpack|export|choose|use|copy|take|name|names|add|repair|leave|give|begin|score|see|build)\b"
)
FOREIGN = b"x y z 1 2\n" * 3
TABLES = (".txt", ".json", ".feather")


def options(words: list[str]) -> DriveOptions:
    flags = dict(zip(words[::2], words[1::2], strict=True))
    truth, fx = flags.get("--truth"), flags.get("--fx")
    return DriveOptions(
        drive=flags.get("--drive"), truth=None if truth is None else Path(truth), fx=None if fx is None else float(fx)
    )


def complaints(words: list[str]) -> Iterator[str]:
    """What opening a drive and reading all of three frames says; anything but a DataError is raised."""
    try:
        drive = open_drive(Path(words[0]), options=options(words[1:]))
    except DataError as error:
        yield str(error)
        return
    for index in range(min(len(drive), 3)):
        try:
            frame = drive[index]
        except DataError as error:
            yield str(error)
            continue
        for read in (frame.pose, *(lambda what=what, frame=frame: frame.read(what) for what in INPUTS)):
            try:
                read()  # type: ignore[operator]
            except DataError as error:
                yield str(error)


def one_of_a_kind(data: Path) -> list[Path]:
    """One file of each folder and kind, and every table, calibration and list."""
    files = sorted(path for path in data.rglob("*") if path.is_file())
    kinds = {(path.parent, path.name if path.suffix in TABLES else path.suffix): path for path in reversed(files)}
    return list(kinds.values())


@pytest.mark.parametrize("name", WRITERS)
def test_what_is_wrong_is_one_line_with_its_mend(tmp_path: Path, name: str) -> None:
    if name == "argoverse2":
        pytest.importorskip("pyarrow", reason="Argoverse 2 is read by pyarrow: the extra argoverse2")
    words = WRITERS[name](tmp_path)
    sound = set(complaints(words))
    for path in one_of_a_kind(tmp_path):
        held = path.read_bytes()
        for content in (None, b"", FOREIGN):
            path.unlink()
            if content is not None:
                path.write_bytes(content)
            for said in set(complaints(words)) - sound:
                assert "\n" not in said and MEND.search(said), f"{path} is {content!r}: {said}"
            path.write_bytes(held)
    assert set(complaints(words)) == sound


@pytest.mark.parametrize("name", ["kitti_stereo", "kitti_object", "kitti_depth"])
def test_a_damaged_first_frame_does_not_close_a_drive(tmp_path: Path, name: str) -> None:
    (path, *words) = WRITERS[name](tmp_path)
    first = open_drive(Path(path), options=options(words))
    next(iter(first.images.values())).write_bytes(FOREIGN)  # type: ignore[attr-defined]
    again = open_drive(Path(path), options=options(words))
    assert again.ids == first.ids and again[1].image().shape[:2] == again[1].camera.size
    with pytest.raises(DataError, match="damaged image"):
        again[0].image()
