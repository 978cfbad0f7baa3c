"""A right camera's pair: whatever is made of it equals, in the mirror, what is made of a left camera's."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from priors.errors import DataError
from priors.filters import Filters
from priors.geometry import mirror_columns
from priors.methods.lidar import stereo_denies
from priors.methods.stereo import Stereo
from priors.pairs.agreement import compare_sweep, match_corners
from priors.pairs.matching import match, quick_match
from priors.pairs.read import Pair, find_range, measure_rectification, read_pair
from priors.pairs.rectification import RectificationError
from priors.types import Camera, Depth, FloatMap, Frame, Sweep

SIZE = (72, 160)
FX, BASELINE_M = 128.0, 0.5
"""Their product is a power of two: disparities turn into depth and back without rounding."""
SEEDS = given(seed=st.integers(0, 10**6))
FEW = settings(max_examples=6, deadline=None)


def left_frame(seed: int) -> Frame:
    """A wall before a wall, seen by the left camera of a pair, and a sweep of both; cx is off the middle."""
    rng = np.random.default_rng(seed)
    near, far = (int(px) for px in (rng.integers(14, 24), rng.integers(4, 10)))
    source = cv2.GaussianBlur(rng.normal(size=(SIZE[0], SIZE[1] + 64)).astype(np.float32), (0, 0), 1.2)
    source = np.clip(128 + 60 * source / source.std(), 0, 255).astype(np.uint8)
    left, right = source[:, : SIZE[1]].copy(), source[:, far : far + SIZE[1]].copy()
    box = source[20:50, 170:200]
    left[20:50, 70:100], right[20:50, 70 - near : 100 - near] = box, box
    disparity_px = np.full(SIZE, far, np.float32)
    disparity_px[20:50, 70:100] = near
    camera = Camera(np.array([[FX, 0, 70.25], [0, FX, 31.5], [0, 0, 1.0]]), SIZE)
    y, x = np.mgrid[1.25 : SIZE[0] - 1 : 2, 1.25 : SIZE[1] - 1 : 2]
    depth_m = FX * BASELINE_M / disparity_px[np.rint(y).astype(int), np.rint(x).astype(int)]
    xyz_m = np.stack([(x - 70.25) / FX, (y - 31.5) / FX, np.ones_like(x)], -1) * depth_m[..., None]
    sweep = Sweep(xyz_m.reshape(-1, 3).astype(np.float32), None)
    readers = {"image": lambda: left, "other": lambda: right, "sweep": lambda offset=0: sweep}
    return Frame("7", camera, readers, T_cam_lidar=np.eye(4), baseline_m=BASELINE_M)


def in_the_mirror(frame: Frame) -> Frame:
    """The same scene as a mirror shows it: left becomes right."""
    K = frame.camera.K.copy()
    K[0, 2] = frame.camera.size[1] - 1 - K[0, 2]
    image, other = np.fliplr(frame.image()).copy(), np.fliplr(frame.other()).copy()
    sweep = frame.sweep()
    assert sweep is not None and frame.T_cam_lidar is not None
    readers = {"image": lambda: image, "other": lambda: other, "sweep": lambda offset=0: sweep}
    flip = np.diag([-1.0, 1.0, 1.0, 1.0])
    side: Any = "right" if frame.side == "left" else "left"
    return replace(
        frame,
        camera=Camera(K, frame.camera.size),
        readers=readers,
        T_cam_lidar=flip @ frame.T_cam_lidar,
        side=side,
    )


def rough_depth(seed: int) -> FloatMap:
    """Depths whose disparities are never halfway between two pixels."""
    disparity_px = np.random.default_rng(seed).integers(3, 26, SIZE).astype(np.float32) + np.float32(0.25)
    return np.float32(FX * BASELINE_M) / disparity_px


def match_full(frame: Frame) -> FloatMap:
    return read_pair(frame).match(lambda left, right: match(left, right, 40))


def match_quickly(frame: Frame) -> FloatMap:
    return read_pair(frame).match(quick_match)


def match_other_view(frame: Frame) -> FloatMap:
    return read_pair(frame).swapped().match(quick_match)


def stereo(frame: Frame) -> FloatMap:
    depth = Stereo(offset_px=(0.5, 0, 2.0)).resolve(frame)(frame)
    return np.concatenate([depth.depth_m, depth.trust()])


@FEW
@SEEDS
@pytest.mark.parametrize("make", [match_full, match_quickly, match_other_view, stereo])
def test_what_is_made_of_a_pair_is_mirrored(make: Callable[[Frame], FloatMap], seed: int) -> None:
    frame = left_frame(seed)
    ours, mirrored = make(frame), make(in_the_mirror(frame))
    assert ours.any()
    np.testing.assert_allclose(mirrored[:, ::-1], ours, rtol=1e-6)


@FEW
@SEEDS
def test_what_is_left_of_a_map_is_mirrored(seed: int) -> None:
    frame, depth_m = left_frame(seed), rough_depth(seed)
    other = in_the_mirror(frame)
    keep = Filters(left_right=2.0)
    ours = keep(Depth(depth_m), frame).depth_m
    assert 0 < np.mean(ours > 0) < 1
    np.testing.assert_array_equal(keep(Depth(np.fliplr(depth_m)), other).depth_m[:, ::-1], ours)
    denied = stereo_denies(frame, depth_m)
    assert 0 < denied.mean() < 1
    np.testing.assert_array_equal(stereo_denies(other, mirror_columns(depth_m))[:, ::-1], denied)


@FEW
@SEEDS
def test_what_is_measured_is_mirrored(seed: int) -> None:
    frame = left_frame(seed)
    other = in_the_mirror(frame)
    measured = [measure_rectification(f, lambda left, right: match(left, right, 40)) for f in (frame, other)]
    assert measured[0] == measured[1].mirrored() != RectificationError()
    swept = [compare_sweep(f, f.sweep(), match_quickly(f)) for f in (frame, other)]
    assert swept[0] is not None and swept[1] is not None and len(swept[0]) > 1000
    np.testing.assert_allclose(swept[1], swept[0], rtol=1e-5)
    assert find_range(frame, read_pair(frame)) == find_range(other, read_pair(other))
    corners = [match_corners(f.image(), f.other(), f.side) for f in (frame, other)]
    assert corners[0] is not None and corners[1] is not None
    np.testing.assert_allclose(np.median(corners[0], axis=0), np.median(corners[1], axis=0), atol=0.2)


@given(seed=st.integers(0, 10**6), mirrored=st.booleans(), colour=st.booleans())
@settings(max_examples=30, deadline=None)
def test_a_pair_can_be_seen_from_either_side(seed: int, mirrored: bool, colour: bool) -> None:
    rng = np.random.default_rng(seed)
    shape = (int(rng.integers(1, 9)), int(rng.integers(1, 9)), *([3] if colour else []))
    left, right = rng.integers(0, 256, (2, *shape), dtype=np.uint8)
    pair = Pair(left, right, mirrored)
    again = pair.swapped().swapped()
    np.testing.assert_array_equal(again.left, left)
    np.testing.assert_array_equal(again.right, right)
    assert again.mirrored == mirrored != pair.swapped().mirrored
    # Restored, the other camera's image is that of the camera on the other side, as it was read.
    as_read = np.fliplr(right) if mirrored else right
    np.testing.assert_array_equal(pair.swapped().restore(pair.swapped().left), as_read)


@pytest.mark.parametrize("use", [stereo, lambda f: Filters(left_right=1)(Depth(rough_depth(0)), f), match_quickly])
def test_a_pair_that_is_none_is_one_line(use: Callable[[Frame], Any]) -> None:
    frame = left_frame(0)
    narrow = replace(frame, readers={**frame.readers, "other": lambda: frame.image()[:, 1:]})
    with pytest.raises(DataError, match="frame 7: the two images of the pair are 160x72 and 159x72") as caught:
        use(narrow)
    assert "\n" not in str(caught.value)
