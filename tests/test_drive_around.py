"""A stretch of a drive, and how drives, frames and maps tell what they are."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nerf.prepare import SceneConfig
from nerf.run import begin
from priors import Stereo, build, open_drive
from priors.drive_around import DriveAround, Stretch
from priors.errors import DataError
from priors.types import Depth

ENDS = st.none() | st.integers(-8, 8)


@given(ENDS, ENDS, st.integers(-3, 3).filter(bool), ENDS, ENDS)
def test_a_stretch_has_what_a_list_s_slice_has(
    street: Path, first: int | None, end: int | None, step: int, again: int | None, last: int | None
) -> None:
    drive = open_drive(street)
    for whole in (drive, DriveAround(drive)):
        part = whole[first:end:step][again:last]
        ids = list(drive.ids)[first:end:step][again:last]
        assert part.ids == ids and len(part) == len(ids)
        assert [part[index].id for index in range(len(part))] == ids
        assert (part.name, part.fingerprint(), part.describe()) == (drive.name, drive.fingerprint(), drive.describe())


def test_a_stretch_is_built_into_the_drive_s_folder(street: Path, tmp_path: Path) -> None:
    drive = open_drive(street)
    part = build.prepare(drive[1:3], Stereo(offset_px=(0,)), folder=tmp_path).run()
    whole = build.prepare(drive, Stereo(offset_px=(0,)), folder=tmp_path)
    assert part.prior.folder == whole.prior.folder
    assert sorted(part.prior.ids()) == list(drive.ids)[1:3]


def test_a_run_of_a_stretch_names_its_frames(street: Path, tmp_path: Path) -> None:
    drive = open_drive(street)
    run = begin(drive[2:5], scene=SceneConfig(views="dense"), folder=tmp_path / "run")
    assert run.config.frames == "2:5"
    with pytest.raises(DataError, match="no range of neighbouring frames"):
        begin(drive[::2], folder=tmp_path / "other")
    with pytest.raises(DataError, match="frames"):
        begin(drive[2:5], scene=SceneConfig(frames="0:2"), folder=tmp_path / "other")


def test_what_they_tell(street: Path) -> None:
    drive = open_drive(street)
    assert repr(drive) == f"KittiRaw({drive.name}, 6 frames, 0000000000 to 0000000005)"
    assert repr(drive[2:3]) == f"Stretch({drive.name}, one frame)"
    assert isinstance(drive[:0], Stretch) and "no frame" in repr(drive[:0])
    assert repr(drive[0]).startswith("Frame(0000000000, 208x64, with image, other")


def test_a_map_tells_its_values_and_shows_them() -> None:
    depth_m = np.zeros((4, 6), np.float32)
    assert repr(Depth(depth_m)) == "Depth(6x4, no value)"
    depth_m[0, :3] = 2, 4, 8
    told = repr(Depth(depth_m, (depth_m > 0).astype(np.float32)))
    assert told == "Depth(6x4, 12.5% of the pixels have 2.0 to 8.0 m, median 4.0 m, with confidence)"
    assert "webp;base64," in Depth(depth_m)._repr_html_()
