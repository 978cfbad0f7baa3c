"""The cache: keys, what counts as done, what is refused."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from priors import cache
from priors.errors import DataError
from priors.types import Depth


def manifest(key: str = "0123456789") -> dict[str, object]:
    return {"format": cache.FORMAT, "key": key, "method": "plane", "drive": {"name": "drive"}}


def some_depth(confidence: bool = True) -> Depth:
    depth_m = np.zeros((4, 6), np.float32)
    depth_m[1:3] = [[1.5, 2, 3, 80, 255.99, 300]] * 2
    return Depth(depth_m, (depth_m > 0).astype(np.float32) * np.float32(0.5) if confidence else None)


def test_what_is_written_is_read_within_half_a_step(tmp_path: Path) -> None:
    prior = cache.create(tmp_path / "drive" / "plane", manifest())
    line = prior.write("000007", some_depth(), seconds=0.1)
    read = prior.read("000007")
    np.testing.assert_allclose(read.depth_m[1, :4], [1.5, 2, 3, 80], atol=1 / 512)
    assert read.depth_m[1, 5] == 0, "300 m cannot be held: no value, not a wrapped one"
    assert line["too_far"] == 2
    assert read.confidence is not None
    np.testing.assert_allclose(read.confidence[1], 0.5, atol=1 / 255)
    assert prior.ids() == ["000007"]
    assert prior.has("000007")


def test_no_confidence_stays_none(tmp_path: Path) -> None:
    prior = cache.create(tmp_path / "drive" / "plane", manifest())
    prior.write("0", some_depth(confidence=False), seconds=0.1)
    assert prior.read("0").confidence is None


@pytest.mark.parametrize("part", ["depth", "confidence"])
@pytest.mark.parametrize("damage", ["missing", "empty", "cut"])
def test_a_half_written_frame_is_not_done_and_is_named(tmp_path: Path, part: str, damage: str) -> None:
    prior = cache.create(tmp_path / "drive" / "plane", manifest())
    prior.write("0", some_depth(), seconds=0.1)
    path = prior.folder / part / "0.png"
    if damage == "missing":
        path.unlink()
    else:
        path.write_bytes(path.read_bytes()[:-20] if damage == "cut" else b"")
    assert not prior.has("0")
    with pytest.raises(DataError, match=rf"{part}/0\.png.*priors build"):
        prior.read("0")


def test_stray_temporary_files_are_no_frames(tmp_path: Path) -> None:
    prior = cache.create(tmp_path / "drive" / "plane", manifest())
    prior.write("0", some_depth(), seconds=0.1)
    (prior.folder / "depth" / ".1.123.abcd.png").write_bytes(b"half")
    assert prior.ids() == ["0"]


def test_what_a_kill_left_behind_is_dropped_when_it_is_old(tmp_path: Path) -> None:
    prior = cache.create(tmp_path / "drive" / "plane", manifest())
    prior.write("0", some_depth(), seconds=0.1)
    old, new = (prior.folder / "depth" / f".{name}.1.ab.png" for name in ("old", "new"))
    for path in (old, new):
        path.write_bytes(b"half")
    os.utime(old, (0, 0))
    os.utime(prior.depth_path("0"), (0, 0))
    prior.drop_stale()
    assert not old.exists()
    assert new.exists(), "another machine may be writing it"
    assert prior.has("0")


def test_a_line_cut_off_by_a_kill_is_left_out(tmp_path: Path) -> None:
    prior = cache.create(tmp_path / "drive" / "plane", manifest())
    prior.write("0", some_depth(), seconds=0.1)
    prior.write("0", some_depth(), seconds=0.2)
    with (prior.folder / "frames.jsonl").open("a") as file:
        file.write('{"id": "1", "seco')
    assert {id_: line["seconds"] for id_, line in prior.lines().items()} == {"0": 0.2}


def test_find_takes_a_prior_a_drive_or_the_cache(tmp_path: Path) -> None:
    first, second = (cache.create(tmp_path / "drive" / f"plane-{key}", manifest(key)) for key in ("aa", "bb"))
    assert [p.name for p in cache.find(first.folder)] == [first.name]
    assert [p.name for p in cache.find(tmp_path / "drive")] == [first.name, second.name]
    assert [p.name for p in cache.find(tmp_path)] == [first.name, second.name]


def test_an_empty_folder_and_no_folder_say_what_to_do(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(DataError, match="priors build"):
            cache.find(path)


def test_another_format_is_refused_and_nothing_is_lost(tmp_path: Path) -> None:
    prior = cache.create(tmp_path / "drive" / "plane", manifest())
    prior.write("0", some_depth(), seconds=0.1)
    path = prior.folder / "manifest.json"
    path.write_text(json.dumps({**manifest(), "format": 99}))
    with pytest.raises(DataError, match=r"format 99, this version reads up to 2: update"):
        cache.create(tmp_path / "drive" / "plane", manifest())
    assert json.loads(path.read_text())["format"] == 99
    assert prior.has("0")


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": 1}', "null"])
def test_a_damaged_manifest_is_named(tmp_path: Path, text: str) -> None:
    prior = cache.create(tmp_path / "drive" / "plane", manifest())
    (prior.folder / "manifest.json").write_text(text)
    with pytest.raises(DataError, match=r"manifest\.json: damaged"):
        cache.find(tmp_path)


def test_maps_without_a_manifest_are_half_written(tmp_path: Path) -> None:
    prior = cache.create(tmp_path / "drive" / "plane", manifest())
    prior.write("0", some_depth(), seconds=0.1)
    (prior.folder / "manifest.json").unlink()
    with pytest.raises(DataError, match="half written"):
        cache.find(tmp_path)
