"""Codecs: nothing wraps, nothing is guessed, nothing half-written stays."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from priors import codecs
from priors.errors import DataError

LARGEST = {"kitti": 65535 / 256, "mm": 65.535}
WELL_INSIDE = {"kitti": 255.75, "mm": 65.5}
STEP = {"kitti": 1 / 256, "mm": 1 / 1000}
encodings = st.sampled_from(["kitti", "mm"])
small_maps = hnp.array_shapes(min_dims=2, max_dims=2, max_side=8)
on_disk = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=40)


@on_disk
@given(st.data(), encodings)
def test_depth_png_round_trip_is_within_half_a_step(tmp_path: Path, data: st.DataObject, encoding: str) -> None:
    depth_m = data.draw(hnp.arrays(np.float32, small_maps, elements=st.floats(0, WELL_INSIDE[encoding], width=32)))
    path = tmp_path / "depth.png"
    assert codecs.write_depth_png(path, depth_m, encoding) == 0
    back = codecs.read_depth_png(path, encoding)
    assert back.dtype == np.float32
    assert np.abs(back.astype(np.float64) - depth_m).max() <= STEP[encoding] / 2 + 1e-5
    assert codecs.write_depth_png(path, back, encoding) == 0
    np.testing.assert_array_equal(codecs.read_depth_png(path, encoding), back)


@given(hnp.arrays(np.float32, small_maps, elements=st.floats(width=32)), encodings)
def test_any_float_becomes_its_nearest_code_or_none(depth_m: np.ndarray, encoding: str) -> None:
    codes, too_large = codecs.encode_depth(depth_m, encoding)
    for value, code in zip(depth_m.ravel().tolist(), codes.ravel().tolist(), strict=True):
        if code:
            assert abs(code * STEP[encoding] - value) <= STEP[encoding] * 0.5000001
        else:
            assert not (STEP[encoding] / 2 < value <= LARGEST[encoding])
    large = np.isfinite(depth_m) & (depth_m.astype(np.float64) >= LARGEST[encoding] + STEP[encoding] / 2)
    assert too_large == np.count_nonzero(large)


@pytest.mark.filterwarnings("error")
def test_the_edges_of_the_kitti_encoding() -> None:
    values = [255.99, 255.9961, 255.999, 256.0, 256.5, 511.9, 65504.0, 1e30, np.inf, np.nan, -5.0, 0.0, 1e-45]
    codes, too_large = codecs.encode_depth(np.array([[*values, 0.4 / 256, 0.6 / 256]]))
    assert codes[0].tolist() == [65533, 65535, *[0] * 12, 1]
    assert too_large == 6  # 255.999 to 1e30: left out and counted; infinity was no value to begin with


def test_empty_map_encodes_to_an_empty_one() -> None:
    codes, too_large = codecs.encode_depth(np.zeros((0, 5), np.float32))
    assert codes.shape == (0, 5)
    assert too_large == 0


@on_disk
@given(hnp.arrays(np.float32, small_maps, elements=st.floats(0, 1, width=32)))
def test_confidence_round_trip_is_within_half_a_step(tmp_path: Path, confidence: np.ndarray) -> None:
    codecs.write_confidence_png(tmp_path / "c.png", confidence)
    np.testing.assert_allclose(codecs.read_confidence_png(tmp_path / "c.png"), confidence, atol=0.5 / 65535 + 1e-7)


def test_confidence_out_of_range_is_brought_in(tmp_path: Path) -> None:
    codecs.write_confidence_png(tmp_path / "c.png", np.array([[-1, 2, np.nan, 0.5]], np.float32))
    np.testing.assert_allclose(codecs.read_confidence_png(tmp_path / "c.png"), [[0, 1, 0, 32768 / 65535]])


def test_confidence_of_eight_bits_is_read(tmp_path: Path) -> None:
    codecs.write_image(tmp_path / "c.png", np.array([[0, 51, 255]], np.uint8))
    np.testing.assert_allclose(codecs.read_confidence_png(tmp_path / "c.png"), [[0, 0.2, 1]])


@on_disk
@given(hnp.arrays(np.float32, small_maps, elements=st.floats(width=32)))
def test_float_formats_keep_values_and_drop_what_is_none(tmp_path: Path, values: np.ndarray) -> None:
    np.save(tmp_path / "a.npy", values)
    np.savez_compressed(tmp_path / "a.npz", depth=values)
    codecs.write_pfm(tmp_path / "a.pfm", values)
    expected = np.where(np.isfinite(values) & (values > 0), values, 0)
    for name in ("a.npy", "a.npz", "a.pfm"):
        read = codecs.read_float_map(tmp_path / name)
        assert read.dtype == np.float32
        np.testing.assert_array_equal(read, expected)


def test_pfm_rows_are_stored_bottom_up_and_both_byte_orders_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.pfm"
    codecs.write_pfm(path, np.array([[1, 2, 3], [4, 5, 6]], np.float32))
    assert np.frombuffer(path.read_bytes()[-24:], "<f4").tolist() == [4, 5, 6, 1, 2, 3]
    path.write_bytes(b"Pf\n3 2\n1.0\n" + np.array([4, 5, 6, 1, 2, 3], ">f4").tobytes())
    np.testing.assert_array_equal(codecs.read_pfm(path), [[1, 2, 3], [4, 5, 6]])


@pytest.mark.parametrize("shape", [(1, 7), (7, 1), (1, 1), (1, 3, 4), (3, 4, 1)])
def test_thin_arrays_and_arrays_with_a_channel_axis_are_maps(tmp_path: Path, shape: tuple[int, ...]) -> None:
    np.save(tmp_path / "a.npy", np.ones(shape, np.float64))
    assert codecs.read_float_map(tmp_path / "a.npy").shape == (shape if len(shape) == 2 else (3, 4))


def bad_files(folder: Path) -> dict[str, Path]:
    """Write files that cannot be read, by what is wrong with them."""
    noise = np.random.default_rng(0).integers(1, 60000, (60, 80)).astype(np.uint16)
    png, pfm, npz = folder / "whole.png", folder / "whole.pfm", folder / "whole.npz"
    codecs.write_depth_png(png, noise / 256)
    codecs.write_pfm(pfm, np.ones((9, 9), np.float32))
    np.savez(npz, np.ones((9, 9)))
    data = png.read_bytes()
    flipped = bytearray(data)
    flipped[len(data) // 2] ^= 0xFF
    contents = {
        "truncated.png": data[: len(data) // 2],
        "cut-at-the-end.png": data[:-12],
        "flipped.png": bytes(flipped),
        "empty.png": b"",
        "text.png": b"<html>404</html>",
        "colour.png": cv2.imencode(".png", np.zeros((4, 4, 3), np.uint8))[1].tobytes(),
        "eight-bit.png": cv2.imencode(".png", np.zeros((4, 4), np.uint8))[1].tobytes(),
        "colour-16.png": cv2.imencode(".png", np.zeros((4, 4, 3), np.uint16))[1].tobytes(),
        "truncated.pfm": pfm.read_bytes()[:-1],
        "header.pfm": b"Pf\n9",
        "colour.pfm": b"PF\n1 1\n-1\n" + bytes(12),
        "negative.pfm": b"Pf\n-3 -3\n-1\n" + bytes(36),
        "truncated.npz": npz.read_bytes()[:-30],
        "empty.npz": b"",
        "garbage.npy": b"garbage",
        "a.exr": b"v/1\x01",
    }
    for name, content in contents.items():
        (folder / name).write_bytes(content)
    np.save(folder / "objects.npy", np.array([{}], object))
    np.save(folder / "words.npy", np.array([["a", "b"]]))
    np.save(folder / "complex.npy", np.ones((3, 3), complex))
    np.save(folder / "one-row.npy", np.ones(5))
    np.save(folder / "volume.npy", np.ones((2, 3, 4)))
    np.savez(folder / "nothing.npz")
    names = [*contents, "objects.npy", "words.npy", "complex.npy", "one-row.npy", "volume.npy", "nothing.npz"]
    return {name: folder / name for name in [*names, "missing.png", "missing.npy", "missing.pfm"]}


def test_what_cannot_be_read_is_named_in_one_line(tmp_path: Path) -> None:
    for name, path in bad_files(tmp_path).items():
        with pytest.raises(DataError) as caught:
            codecs.read_float_map(path)
        assert str(path) in str(caught.value), name
        assert "\n" not in str(caught.value), name


def test_damaged_images_are_named(tmp_path: Path) -> None:
    image = np.random.default_rng(0).integers(0, 255, (60, 80, 3)).astype(np.uint8)
    for suffix in (".png", ".jpg"):
        path = tmp_path / f"image{suffix}"
        codecs.write_image(path, image)
        path.write_bytes(path.read_bytes()[:-200])
        with pytest.raises(DataError, match="damaged image"):
            codecs.read_image(path)
    codecs.write_depth_png(path := tmp_path / "depth.png", np.ones((4, 4)))
    with pytest.raises(DataError, match="8-bit"):
        codecs.read_image(path)


def test_images_are_rgb_and_lossless_as_png(tmp_path: Path) -> None:
    image = np.zeros((2, 2, 3), np.uint8)
    image[..., 0] = 200
    codecs.write_image(tmp_path / "a.png", image)
    assert cv2.imread(str(tmp_path / "a.png"))[0, 0].tolist() == [0, 0, 200]  # OpenCV reads BGR
    np.testing.assert_array_equal(codecs.read_image(tmp_path / "a.png"), image)
    codecs.write_image(tmp_path / "g.png", image[..., 0])
    np.testing.assert_array_equal(codecs.read_image(tmp_path / "g.png"), image[..., 0])
    cv2.imwrite(str(tmp_path / "alpha.png"), np.dstack([image[..., ::-1], image[..., 1]]))
    np.testing.assert_array_equal(codecs.read_image(tmp_path / "alpha.png"), image)


def test_paths_may_hold_any_letters(tmp_path: Path) -> None:
    folder = tmp_path / "Straße 道路 with spaces"
    codecs.write_depth_png(folder / "größe.png", np.full((2, 2), 7.0))
    codecs.write_image(folder / "画像.jpg", np.full((8, 8), 90, np.uint8))
    codecs.write_pfm(folder / "é.pfm", np.ones((2, 2), np.float32))
    assert codecs.read_depth_png(folder / "größe.png")[0, 0] == 7
    assert codecs.read_image(folder / "画像.jpg").shape == (8, 8)
    assert codecs.read_float_map(folder / "é.pfm")[0, 0] == 1
    assert sorted(path.name for path in folder.iterdir()) == sorted(["größe.png", "画像.jpg", "é.pfm"])


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_bytes_behind_an_image_are_nobodys_and_a_cut_one_is_damaged(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"image{suffix}"
    codecs.write_image(path, np.random.default_rng(0).integers(0, 255, (32, 48, 3), dtype=np.uint8))
    image, data = codecs.read_image(path), path.read_bytes()
    for tail in (bytes(512), bytes(4096), b"IEND", b"\xff"):
        path.write_bytes(data + tail)
        assert np.array_equal(codecs.read_image(path), image)
    for kept in (len(data) // 2, len(data) - 13):
        path.write_bytes(data[:kept])
        with pytest.raises(DataError, match="damaged image"):
            codecs.read_image(path)


def test_a_preview_inside_a_jpeg_does_not_end_it(tmp_path: Path) -> None:
    """Phones put a small JPEG into a segment, and a film behind the end; both hold marks of their own."""
    small = codecs.encode_image(tmp_path / "a.jpg", np.full((8, 8), 90, np.uint8))
    image = np.random.default_rng(0).integers(0, 255, (32, 48), dtype=np.uint8)
    data = codecs.encode_image(tmp_path / "a.jpg", image)
    with_preview = data[:2] + b"\xff\xe1" + (len(small) + 2).to_bytes(2, "big") + small + data[2:]
    path = tmp_path / "a.jpg"
    path.write_bytes(data)
    expected = codecs.read_image(path)
    path.write_bytes(with_preview + b"\xff\xda film")
    np.testing.assert_array_equal(codecs.read_image(path), expected)
    for kept in (len(small) + 10, len(with_preview) // 2, len(with_preview) - 2):
        path.write_bytes(with_preview[:kept])
        with pytest.raises(DataError, match="damaged image"):
            codecs.read_image(path)


@pytest.mark.parametrize(
    ("pixels", "told"),
    [
        (np.ones((4, 6), np.uint8), "8 bits and 1 channel: write uint16, metres x 256"),
        (np.ones((4, 6, 3), np.uint8), "8 bits and 3 channels: is this a colour map"),
        (np.ones((4, 6, 3), np.uint16), "16 bits and 3 channels"),
    ],
)
def test_a_png_that_is_no_depth_map_is_told(tmp_path: Path, pixels: np.ndarray, told: str) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), pixels)
    with pytest.raises(DataError, match=told):
        codecs.read_float_map(tmp_path / "a.png")
