"""Plain images: their focal length, how the camera was held, and mono from end to end."""

from pathlib import Path

import numpy as np
import pytest
from factories import scene
from PIL import Image as Pillow

from cli.priors import PROGRAM
from priors import cache, places
from priors.drives import DriveOptions, open_drive, reopen
from priors.errors import DataError, UsageError

pytestmark = pytest.mark.datasets
FOCAL_MM, FOCAL_35MM, X_RESOLUTION, UNIT, WIDTH, HEIGHT = 0x920A, 0xA405, 0xA20E, 0xA210, 0xA002, 0xA003


def write_picture(
    path: Path, pixels: np.ndarray, orientation: int = 1, details: dict[int, float] | None = None
) -> None:
    """Write a picture with what a camera says of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    exif = Pillow.Exif()
    exif[0x0112] = orientation
    exif[0x8769] = details or {}
    Pillow.fromarray(pixels).save(path, exif=exif, **({"quality": 98} if path.suffix == ".jpg" else {}))


def test_the_focal_length_is_typed_or_exif_s(tmp_path: Path) -> None:
    pixels = np.zeros((96, 240, 3), np.uint8)
    write_picture(tmp_path / "a.jpg", pixels, details={FOCAL_35MM: 28})
    drive = open_drive(tmp_path)
    assert drive.describe()["dataset"] == "images" and "cameras" not in drive.describe()
    assert drive[0].camera.fx == pytest.approx(28 * np.hypot(96, 240) / np.hypot(36, 24))
    np.testing.assert_array_equal(drive[0].camera.K[:2, 2], [119.5, 47.5])
    typed = open_drive(tmp_path, options=DriveOptions(fx=333.5))
    assert typed[0].camera.fx == 333.5 and reopen(typed.describe())[0].camera.fx == 333.5
    # 5 mm behind 100 pixels a mm, 480 pixels wide, resized to half
    exact = {FOCAL_MM: 5, X_RESOLUTION: 1000, UNIT: 3, WIDTH: 480, HEIGHT: 192, FOCAL_35MM: 28}
    write_picture(tmp_path / "b.jpg", pixels, details=exact)
    mixed = open_drive(tmp_path)
    assert mixed[1].camera.fx == pytest.approx(5 * 100 / 2) and mixed.describe()["cameras"] == "by frame"


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_pictures_are_upright_as_a_viewer_shows_them(tmp_path: Path, orientation: int, suffix: str) -> None:
    from PIL import ImageOps

    pixels = np.repeat(scene((60, 90))[0][..., None], 3, axis=2)
    write_picture(tmp_path / f"a{suffix}", pixels, orientation)
    with Pillow.open(tmp_path / f"a{suffix}") as picture:
        viewed = np.asarray(ImageOps.exif_transpose(picture))
    frame = open_drive(tmp_path, options=DriveOptions(fx=80.0))[0]
    assert frame.camera.size == viewed.shape[:2]
    np.testing.assert_allclose(frame.image().astype(int), viewed, atol=4)  # two decoders of JPEG


def test_mono_works_from_end_to_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photos = tmp_path / "photos"
    for number, size in enumerate([(96, 160), (160, 96)]):
        write_picture(photos / f"{number}.jpg", np.repeat(scene(size)[0][..., None], 3, axis=2))
    arguments = [str(photos), "--fx", "150"]
    assert PROGRAM.run(["check", *arguments]) == 0
    folder = str(tmp_path / "cache")
    assert PROGRAM.run(["build", *arguments, "--method", "auto", "--cache", folder]) == 0
    prior = cache.only(tmp_path / "cache")
    assert prior.method == "mono" and prior.drive["fx"] == 150
    assert [prior.read(id_).depth_m.shape for id_ in prior.ids()] == [(96, 160), (160, 96)]
    assert PROGRAM.run(["build", *arguments, "--method", "mono", "--cache", folder, "--dry-run"]) == 0
    assert "0 to compute, 2 skipped" in capsys.readouterr().out
    assert PROGRAM.run(["show", folder, "--out", str(tmp_path / "pictures")]) == 0
    assert PROGRAM.run(["check", folder]) == 0


def test_bad_input_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"no images \(\.png, \.jpg.*\): name the folder that holds them"):
        open_drive(tmp_path, "images")
    write_picture(tmp_path / "b.jpg", np.zeros((96, 240, 3), np.uint8))
    with pytest.raises(DataError, match=r"b\.jpg: its EXIF tells no focal length: give it in pixels, --fx"):
        open_drive(tmp_path)
    for options, message in (
        (DriveOptions(fx=9.0, camera="left"), "has one camera: leave --camera left out"),
        (DriveOptions(fx=9.0, drive="x"), "is one drive, there is no 'x' in it"),
        (DriveOptions(fx=9.0, truth=tmp_path), "images alone have no truth"),
    ):
        with pytest.raises(UsageError, match=message):
            open_drive(tmp_path, options=options)
    for fx in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(UsageError, match=r"--fx .*: expected pixels, more than 0"):
            DriveOptions(fx=fx)
    options = DriveOptions(fx=150.0)
    (tmp_path / "a.jpg").write_bytes(b"\xff\xd8 no picture")
    drive = open_drive(tmp_path, options=options)
    assert drive.ids == ["a", "b"] and drive[1].image().shape == (96, 240, 3)
    with pytest.raises(DataError, match=r"a\.jpg: damaged image"):
        _ = drive[0]
    write_picture(tmp_path / "c.jpg", np.zeros((96, 260, 3), np.uint8))
    with pytest.raises(UsageError, match=r"--fx 150: the images have several sizes \(240x96 and 260x96\)"):
        open_drive(tmp_path, options=options)


def test_fx_is_refused_where_there_is_a_calibration(image_folder: Path) -> None:
    with pytest.raises(UsageError, match="--fx 700: folder has its own calibration: leave it out"):
        open_drive(image_folder, options=DriveOptions(fx=700.0))


def test_pictures_are_no_drive_to_be_found(tmp_path: Path) -> None:
    write_picture(tmp_path / "holiday" / "a.jpg", np.zeros((96, 240, 3), np.uint8), details={FOCAL_35MM: 28})
    assert places.places(tmp_path) == []
    assert open_drive(tmp_path / "holiday").name == "holiday"
