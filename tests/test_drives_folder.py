"""A folder of one's own images: joins by stem, calibration, poses, depth in any encoding."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from factories import BASELINE_M, SIZE, STEP_M, depth_m, scene, write_folder
from hypothesis import given, settings
from hypothesis import strategies as st

from priors import codecs
from priors.drives import DriveOptions, open_drive, reopen
from priors.drives._rigs import KITTI
from priors.errors import DataError
from priors.pairs.read import read_pair


def test_reads_pair_truth_and_poses(image_folder: Path) -> None:
    drive = open_drive(image_folder)
    frame = drive[1]
    assert drive.name == "mine" and list(drive.ids) == ["a", "b", "c"]
    assert frame.baseline_m == BASELINE_M and frame.camera.size == SIZE
    np.testing.assert_array_equal(frame.other()[..., 0], scene(seed=1)[1])
    np.testing.assert_allclose(frame.truth().depth_m, depth_m(scene()[2]), atol=1 / 512)
    np.testing.assert_allclose(frame.T_world_cam[:3, 3], [0, 0, STEP_M])
    with pytest.raises(DataError, match="has no LiDAR: use stereo"):
        frame.sweep()
    assert reopen(drive.describe()).fingerprint() == drive.fingerprint()


def test_right_camera(image_folder: Path) -> None:
    frame = open_drive(image_folder, options=DriveOptions(camera="right"))[1]
    assert frame.side == "right"
    np.testing.assert_allclose(frame.T_world_cam[:3, 3], [BASELINE_M, 0, STEP_M])


def test_left_alone(tmp_path: Path) -> None:
    write_folder(tmp_path, right=False)
    calib = json.loads((tmp_path / "calib.json").read_text())
    del calib["baseline_m"]
    (tmp_path / "calib.json").write_text(json.dumps(calib))
    frame = open_drive(tmp_path)[0]
    assert frame.baseline_m is None
    with pytest.raises(DataError, match=r"right: no image a: stereo needs both cameras"):
        frame.other()


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".pfm"])
def test_depth_encodings(image_folder: Path, suffix: str) -> None:
    (image_folder / "depth" / "b.png").unlink()
    depth = np.full(SIZE, 33.25, np.float32)
    depth[0, 0] = np.nan
    path = image_folder / "depth" / f"b{suffix}"
    if suffix == ".pfm":
        codecs.write_pfm(path, depth)
    else:
        {".npy": np.save, ".npz": np.savez}[suffix](path, depth)
    found = open_drive(image_folder)[1].truth().depth_m
    assert found[0, 0] == 0 and (found.ravel()[1:] == 33.25).all()


@settings(max_examples=25, deadline=None)
@given(kept=st.lists(st.tuples(st.booleans(), st.booleans(), st.booleans()), min_size=1, max_size=5))
def test_files_are_joined_by_stem(tmp_path_factory: pytest.TempPathFactory, kept: list[tuple[bool, ...]]) -> None:
    ids = [f"{n:03d}" for n in range(len(kept))]
    root = write_folder(tmp_path_factory.mktemp("own"), ids)
    (root / "poses.txt").unlink()
    lines = [
        f"{id_} 1 0 0 {n} 0 1 0 0 0 0 1 0\n"
        for n, (id_, (_, _, pose)) in enumerate(zip(ids, kept, strict=True))
        if pose
    ]
    if lines:
        (root / "poses.txt").write_text("".join(reversed(lines)))
    for id_, (right, depth, _) in zip(ids, kept, strict=True):
        if not right:
            (root / "right" / f"{id_}.png").unlink()
        if not depth:
            (root / "depth" / f"{id_}.png").unlink()
    drive = open_drive(root)
    for n, (right, depth, pose) in enumerate(kept):
        frame = drive[n]
        assert (frame.has("other"), frame.has("truth"), frame.T_world_cam is not None) == (right, depth, pose)
        if pose:
            assert frame.T_world_cam[0, 3] == n


def _without(key: str) -> Callable[[dict], dict]:
    return lambda calib: {k: v for k, v in calib.items() if k != key}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_without("fx"), r"calib\.json: fx should be a number: it is missing"),
        (_without("baseline_m"), r"calib\.json: baseline_m should be a number: it is missing"),
        (lambda c: c | {"cy": "47"}, r"calib\.json: cy should be a number: found '47'"),
        (lambda c: c | {"fy": -3}, r"calib\.json: fx and fy should be > 0"),
        (lambda c: c | {"baseline_m": 0}, r"calib\.json: the baseline .* is 0\.000 m, expected > 0"),
        (lambda c: c | {"baseline_m": -0.5}, r"calib\.json: the baseline .* is -0\.500 m, expected > 0"),
        (lambda c: c | {"cx": 400}, r"calib\.json: the centre .* lies outside the 240x96 images"),
    ],
)
def test_bad_calibration_is_named(image_folder: Path, change: Callable[[dict], dict], message: str) -> None:
    path = image_folder / "calib.json"
    path.write_text(json.dumps(change(json.loads(path.read_text()))))
    with pytest.raises(DataError, match=message):
        open_drive(image_folder)


def test_size_unlike_the_calibrations_is_named(image_folder: Path) -> None:
    path = image_folder / "calib.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"width": 480, "height": 192}))
    with pytest.raises(DataError, match=r"left/a\.png: is 240x96, the calibration is for 480x192"):
        open_drive(image_folder)[0].image()


def test_pose_count_unlike_the_images_is_named(image_folder: Path) -> None:
    path = image_folder / "poses.txt"
    path.write_text("".join(path.read_text().splitlines(True)[:2]))
    drive = open_drive(image_folder)
    assert drive[0].other().shape == (*SIZE, 3)  # stereo needs no pose
    with pytest.raises(DataError, match=r"poses\.txt: 2 poses for 3 left images"):
        drive[0].pose()


def test_numbers_sort_and_join_as_numbers(image_folder: Path) -> None:
    names = dict(zip("abc", ("9", "10", "0011"), strict=True))
    for path in list(image_folder.glob("*/*.png")):
        folder, number = path.parent.name, names[path.stem]
        path.rename(path.with_name(f"{number if folder == 'left' else number.zfill(6)}.png"))
    lines = (image_folder / "poses.txt").read_text().splitlines()
    numbered = [f"{int(number):06d} {line}" for number, line in zip(names.values(), lines, strict=True)]
    (image_folder / "poses.txt").write_bytes("\r\n".join(["# h\u00f6he", *reversed(numbered)]).encode("latin-1"))
    drive = open_drive(image_folder)
    assert list(drive.ids) == ["9", "10", "0011"]
    for frame, line in zip(drive, lines, strict=True):
        assert frame.has("other") and np.allclose(frame.pose()[:3].ravel(), np.array(line.split(), float))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_text_that_windows_wrote_is_read(image_folder: Path, encoding: str) -> None:
    poses = [frame.pose() for frame in open_drive(image_folder)]
    for name in ("calib.json", "poses.txt"):
        text = (image_folder / name).read_text()
        (image_folder / name).write_bytes(text.replace("\n", "\r\n").encode(encoding))
    assert np.array_equal([frame.pose() for frame in open_drive(image_folder)], poses)


def test_a_grey_left_and_a_coloured_right_match_in_grey(image_folder: Path) -> None:
    for path in (image_folder / "left").glob("*.png"):
        codecs.write_image(path, codecs.as_grey(codecs.read_image(path)))
    pair = read_pair(open_drive(image_folder)[0])
    assert pair.left.shape == pair.right.shape == SIZE


@pytest.mark.parametrize("name", [".", "left/..", "../{}/"])
def test_a_folder_has_its_name_however_it_is_called(
    image_folder: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(image_folder)
    assert open_drive(Path(name.format(image_folder.name))).name == image_folder.name


def test_one_damaged_image_does_not_close_the_folder(image_folder: Path) -> None:
    (image_folder / "left" / "a.png").write_bytes(b"\x89PNG\r\n")
    drive = open_drive(image_folder)
    assert drive[1].image().shape == (*SIZE, 3)
    with pytest.raises(DataError, match=r"left/a\.png: damaged image"):
        drive[0].image()


def test_the_rig_is_named_or_refused(tmp_path: Path) -> None:
    write_folder(tmp_path)
    calibration = json.loads((tmp_path / "calib.json").read_text())
    assert open_drive(tmp_path)[0].rig is None
    (tmp_path / "calib.json").write_text(json.dumps({**calibration, "rig": "kitti"}))
    assert open_drive(tmp_path)[0].rig == KITTI
    (tmp_path / "calib.json").write_text(json.dumps({**calibration, "rig": "kiti"}))
    with pytest.raises(DataError, match=r"calib.json: rig 'kiti' is not known: leave it out, or choose one of kitti"):
        _ = open_drive(tmp_path)[0]
