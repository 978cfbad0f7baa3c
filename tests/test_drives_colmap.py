"""COLMAP's sparse models, text and binary: lenses, pixel centres, poses, points, and the study's release."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from independent import parse
from layouts.colmap import MODELS, POINTS, projected, write_colmap
from layouts.posed import CX, CY, FX, SIZE, K, bend, seen_by

from cli.priors import PROGRAM
from priors import codecs
from priors.check import check
from priors.drives import DriveOptions, open_drive, reopen
from priors.drives._colmap_model import read_lenses
from priors.errors import DataError, UsageError
from priors.geometry import invert

pytestmark = pytest.mark.datasets
READ = [name for name in MODELS if name != "OPENCV_FISHEYE"]


@pytest.mark.parametrize("binary", [True, False], ids=["binary", "text"])
@pytest.mark.parametrize("place", ["sparse/0", "sparse", "."])
def test_poses_images_and_points(tmp_path: Path, binary: bool, place: str) -> None:
    written = write_colmap(tmp_path / "scene", binary=binary, place=place)
    drive = open_drive(tmp_path / "scene")
    assert drive.name == "scene" and drive.describe()["dataset"] == "colmap"
    assert drive.ids == ["shot_0", "shot_1", "shot_2"]
    for frame, view in zip(drive, written.views, strict=True):
        np.testing.assert_allclose(frame.pose(), view.T_world_cam, atol=1e-12)
        shown, _ = seen_by(view.T_world_cam, frame.camera.K, SIZE)
        assert np.abs(frame.image().astype(int) - shown).max() <= 4
    for frame, view in zip(drive, written.views[:2], strict=False):
        wanted = np.zeros(SIZE)
        for column, row, z in projected(view, frame.camera.K, written.seen[view.name]):
            wanted[row, column] = z
        assert np.count_nonzero(wanted) >= 3
        np.testing.assert_allclose(frame.sparse().depth_m, wanted, rtol=1e-6)
    with pytest.raises(DataError, match=r"images\.(bin|txt): shot_2\.png observes no points: use mono"):
        drive[2].sparse()
    assert reopen(drive.describe()).fingerprint() == drive.fingerprint()


@pytest.mark.parametrize("model", READ)
def test_lenses_bend_as_the_model_says(tmp_path: Path, model: str) -> None:
    write_colmap(tmp_path, model)
    lens = read_lenses(tmp_path / "sparse" / "0" / "cameras.bin")[3]
    fy = FX if model.startswith(("SIMPLE", "RADIAL")) else K[1, 1]
    assert (lens.focal_px, lens.centre_px, lens.size) == ((FX, fy), (CX, CY), SIZE)
    numbers = MODELS[model][1][3 if model.startswith(("SIMPLE", "RADIAL")) else 4 :]
    distortion = tuple(numbers[:4]) + (0.0,) * (4 - len(numbers[:4]))
    xy = np.array([[0.3, -0.2], [-0.5, 0.1]])
    objects = np.hstack([xy, np.ones((2, 1))])
    found, _ = cv2.projectPoints(objects, np.zeros(3), np.zeros(3), lens.K, np.array(lens.distortion or (0.0,) * 4))
    wanted = bend(xy, distortion) * [FX, fy] + [CX, CY]
    np.testing.assert_allclose(found[:, 0], wanted, atol=1e-9)
    assert lens.bends == ("PINHOLE" not in model)


def test_pycolmap_reads_the_same(tmp_path: Path) -> None:
    """One run of theirs for all models, binary and text."""
    roots = {tmp_path / f"{model}-{binary}": (model, binary) for model in READ for binary in (True, False)}
    models = {root: write_colmap(root, *how) for root, how in roots.items()}
    theirs = parse("read_colmap.py", *(root / "sparse" / "0" for root in models))
    for root, written in models.items():
        own, drive = theirs[str(root / "sparse" / "0")], open_drive(root)
        assert {int(id_) for id_ in own["points"]} == {id_ for id_, _ in POINTS}
        for frame, view in zip(drive, written.views, strict=True):
            image = own["images"][view.name]
            np.testing.assert_allclose(invert(frame.pose()), image["T_cam_world"], atol=1e-9)
            assert image["points"] == written.seen[view.name] and tuple(image["size"]) == SIZE
            lens = drive.views[frame.id].lens
            found, _ = cv2.projectPoints(
                np.hstack([image["straight"], np.ones((3, 1))]),
                np.zeros(3), np.zeros(3), lens.K, np.array(lens.distortion or (0.0,) * 4),
            )  # fmt: skip
            np.testing.assert_allclose(found[:, 0], np.array(own["grid"]) - 0.5, atol=1e-6)


def test_a_straight_camera_s_images_are_left_alone(tmp_path: Path) -> None:
    written = write_colmap(tmp_path, "PINHOLE")
    frame = open_drive(tmp_path)[1]
    np.testing.assert_array_equal(frame.image(), written.views[1].image)
    np.testing.assert_array_equal(frame.camera.K, K)


def test_the_study_s_release(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Poses as text without points, truth in depths_gt, others' priors beside, which lack the upper rows."""
    written = write_colmap(tmp_path, "PINHOLE", binary=False)
    (tmp_path / "sparse" / "0" / "points3D.txt").write_text("")
    for view in written.views:
        stem = Path(view.name).stem
        codecs.write_depth_png(tmp_path / "depths_gt" / f"{stem}.png", view.depth_m)
        cropped_m = 1.1 * view.depth_m
        cropped_m[: len(cropped_m) // 3] = 0
        codecs.write_depth_png(tmp_path / "depths_mono_crop" / f"{stem}.png", cropped_m)
    drive = open_drive(tmp_path)
    for frame, view in zip(drive, written.views, strict=True):
        np.testing.assert_allclose(frame.truth().depth_m, view.depth_m, atol=0.51 / 256)
    notes = [finding.message for finding in check(drive)]
    assert any("depth maps of others beside: depths_mono_crop: `priors import` takes them" in note for note in notes)
    home = str(tmp_path / "cache")
    mono = ["--depth", str(tmp_path / "depths_mono_crop"), "--unit", "1/256"]
    assert PROGRAM.run(["import", str(tmp_path), *mono, "--cache", home]) == 0
    assert PROGRAM.run(["eval", home]) == 0 and "imported depths_mono_crop" in capsys.readouterr().out
    (tmp_path / "depths_gt").rename(tmp_path / "depths")  # as for Argoverse
    assert open_drive(tmp_path)[0].has("truth")
    (tmp_path / "depths").rename(tmp_path / "elsewhere")
    assert not open_drive(tmp_path)[0].has("truth")
    assert open_drive(tmp_path, options=DriveOptions(truth=tmp_path / "elsewhere"))[0].has("truth")


@pytest.mark.parametrize("table", ["cameras", "images", "points3D"])
@pytest.mark.parametrize("binary", [True, False], ids=["binary", "text"])
def test_a_damaged_table_is_one_line(tmp_path: Path, table: str, binary: bool) -> None:
    write_colmap(tmp_path, binary=binary)
    path = tmp_path / "sparse" / "0" / f"{table}.{'bin' if binary else 'txt'}"
    data = path.read_bytes()
    path.write_bytes(data[:-20] if binary else data.replace(b".", b",").replace(b" 3 OPENCV", b" 3"))
    with pytest.raises(
        DataError, match=rf"{path.name}: ((damaged \(.*\)|ends within a record): export the model again|no camera 3)"
    ):
        open_drive(tmp_path)[0].sparse()


def test_bad_input_is_one_line(tmp_path: Path) -> None:
    write_colmap(tmp_path, "OPENCV_FISHEYE", binary=False)
    with pytest.raises(DataError, match=r"camera 3 is OPENCV_FISHEYE, which is not read: run `colmap image_und"):
        open_drive(tmp_path)
    with pytest.raises(DataError, match="no cameras and images tables"):
        open_drive(tmp_path / "images", "colmap")
    write_colmap(tmp_path)  # the binary tables win
    for options, message in (
        (DriveOptions(camera="left"), "all images of the model are one drive: leave --camera left out"),
        (DriveOptions(drive="x"), "leave --drive out"),
    ):
        with pytest.raises(UsageError, match=message):
            open_drive(tmp_path, options=options)
    with pytest.raises(DataError, match="--truth should hold depth maps, uint16 PNG of metres x 256, found none"):
        open_drive(tmp_path, options=DriveOptions(truth=tmp_path / "sparse"))
    for name in ("points3D.bin", "points3D.txt"):
        (tmp_path / "sparse" / "0" / name).unlink()
    with pytest.raises(DataError, match=r"sparse/0: no points3D table: copy it beside the others"):
        open_drive(tmp_path)[0].sparse()
    for path in (tmp_path / "images").iterdir():
        path.unlink()
    with pytest.raises(DataError, match=r"images/shot_0\.png: no such file: none of its 3 images is there"):
        open_drive(tmp_path)


def test_completion_fills_the_points(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_colmap(tmp_path / "scene")
    assert PROGRAM.run(["check", str(tmp_path / "scene")]) == 0
    flags = ["--method", "auto", "--cache", str(tmp_path / "cache")]
    assert PROGRAM.run(["build", str(tmp_path / "scene"), *flags]) == 0
    printed = capsys.readouterr()
    assert "method: completion: it has sparse depth maps and no stereo pair" in printed.err
