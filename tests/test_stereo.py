"""Stereo: bias, symmetry, filling, confidence, bad input, and the figures on real frames."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from reference import stereo as reference

from priors import build
from priors.codecs import FARTHEST_M
from priors.drives import DriveOptions, open_drive
from priors.drives._rigs import KITTI
from priors.errors import DataError
from priors.kernels.diffusion import diffuse_columns, link_columns
from priors.kernels.occlusion import fill_occlusions
from priors.methods.stereo import Stereo
from priors.pairs.matching import find_max_disparity, halve, match, quick_match, unlock
from priors.pairs.rectification import NONE, RectificationError, compare, fit, usual_error
from priors.pairs.smoothing import diffuse
from priors.selection import Selection
from priors.types import Camera, Depth, FloatMap, Frame, Rig, Sweep

FX, BASELINE_M = 500.0, 0.5
ZERO = (0.0, 0.0, 0.0, 0.0)
IMAGES_ONLY = Stereo(offset_px=ZERO)
Rows = npt.NDArray[np.floating]


def texture(height: int, width: int, seed: int = 0) -> Rows:
    noise = np.random.default_rng(seed).normal(size=(height, width)).astype(np.float32)
    blurred = cv2.GaussianBlur(noise, (0, 0), 1.2)
    return 128 + 40 * blurred / blurred.std()


def pair(disparity_px: Rows, seed: int = 0) -> tuple[Any, Any]:
    """Views of one texture, each moved by half the disparity of its row, so that neither is sharper."""
    height, width, border = 120, 320, 64
    disparity_px = np.broadcast_to(np.asarray(disparity_px, dtype=np.float32), (height, 1))
    source = texture(height, width + 2 * border, seed)
    rows, columns = np.mgrid[:height, border : width + border].astype(np.float32)
    views = [cv2.remap(source, columns + sign * disparity_px / 2, rows, cv2.INTER_LANCZOS4) for sign in (-1, 1)]
    left, right = (np.clip(np.rint(view), 0, 255).astype(np.uint8) for view in views)
    return left, right


def frame(image: Any, other: Any, **changes: Any) -> Frame:
    height, width = image.shape[:2]
    camera = Camera(np.array([[FX, 0, width / 2], [0, FX, height / 2], [0, 0, 1]]), (height, width))
    made = Frame("0", camera, {"image": lambda: image, "other": lambda: other}, baseline_m=BASELINE_M)
    return replace(made, **changes)


def scene() -> tuple[Any, Any, Rows]:
    """A textured wall at 8 px with a textured box at 24 px before it: left, right, left's true disparity."""
    wall = texture(120, 400, 2)
    left, right = wall[:, 8:328].copy(), wall[:, 16:336].copy()
    box = texture(60, 80, 3)
    left[30:90, 150:230], right[30:90, 126:206] = box, box
    truth_px = np.full((120, 320), 8.0)
    truth_px[30:90, 150:230] = 24
    as_image = [np.clip(np.rint(view), 0, 255).astype(np.uint8) for view in (left, right)]
    return as_image[0], as_image[1], truth_px


@pytest.mark.parametrize("disparity_px", [12.0, 12.25, 12.5, 12.75, 30.4])
def test_known_shifts_have_no_bias(disparity_px: float) -> None:
    matched_px = match(*pair(disparity_px))[:, 40:-40]
    assert np.mean(matched_px > 0) > 0.9
    assert abs(np.mean(matched_px[matched_px > 0]) - disparity_px) < 0.05


@pytest.mark.parametrize("rows_per_px", [0.3, -0.3])
def test_slanted_road_has_no_bias(rows_per_px: float) -> None:
    truth_px = 20 + rows_per_px * (np.arange(120.0)[:, None] - 60) / 2
    matched_px = match(*pair(truth_px))
    error_px = (matched_px - truth_px)[10:-10, 60:-60][matched_px[10:-10, 60:-60] > 0]
    assert abs(np.mean(error_px)) < 0.05


def test_unlock_keeps_order() -> None:
    codes = np.arange(-16, 64, dtype=np.int16)[None]
    unlocked_px = unlock(codes)
    assert unlocked_px.dtype == np.float32 and not unlocked_px[codes <= 0].any()
    assert np.all(np.diff(unlocked_px[codes >= 0]) > 0)
    assert np.all(np.abs(unlocked_px - np.maximum(codes, 0) / 16) < 0.25)


def test_range_comes_from_the_scene() -> None:
    assert find_max_disparity(*pair(12.0)) < find_max_disparity(*pair(45.0))
    assert find_max_disparity(*pair(45.0)) >= 45


def test_left_border_has_values() -> None:
    left, right, truth_px = scene()
    matched_px = match(left, right, 64)
    assert np.mean(np.abs(matched_px - truth_px)[:, 12:60] < 0.5) > 0.9


def test_quick_match_is_rough_but_right() -> None:
    left, right, truth_px = scene()
    quick_px = quick_match(left[:119, :319], right[:119, :319])
    assert quick_px.shape == (119, 319) and quick_px.dtype == np.float32
    matched = quick_px > 0
    assert matched.mean() > 0.6
    assert np.mean(np.abs(quick_px - truth_px[:119, :319])[matched] < 1) > 0.95


def test_halve_doubles_an_odd_border() -> None:
    assert halve(np.array([[0, 100, 8]], dtype=np.uint8)).tolist() == [[50, 8]]


def test_depth_and_confidence() -> None:
    left, right, truth_px = scene()
    depth = IMAGES_ONLY(frame(left, right))
    assert depth.confidence is not None
    assert depth.depth_m.dtype == depth.confidence.dtype == np.float32
    assert depth.density == 1
    assert depth.confidence.min() >= 0 and depth.confidence.max() <= 1
    disparity_px = FX * BASELINE_M / depth.depth_m
    wrong = np.abs(disparity_px - truth_px) > 1
    assert wrong.mean() < 0.04
    on_box = truth_px == 24  # the wall is far: its confidence is low in any case
    assert depth.confidence[wrong & on_box].mean() < 0.8 < 0.95 < depth.confidence[~wrong & on_box].mean()
    assert depth.confidence[40:80, 136:148].mean() < 0.7 * depth.confidence[40:80, 20:120].mean()


def test_occlusion_takes_the_background() -> None:
    left, right, truth_px = scene()
    hidden = np.s_[40:80, 136:148]  # 16 columns left of the box are not in the right view
    assert np.mean(match(left, right)[hidden] > 0) < 0.5
    disparity_px = FX * BASELINE_M / IMAGES_ONLY(frame(left, right)).depth_m
    assert np.median(disparity_px[hidden]) < 12 and truth_px[hidden].max() == 8


def test_right_camera_is_the_left_one_in_the_mirror() -> None:
    left, right, _ = scene()
    mirrored = IMAGES_ONLY(frame(right[:, ::-1], left[:, ::-1]))
    depth = IMAGES_ONLY(frame(right, left, side="right"))
    assert np.array_equal(depth.depth_m, mirrored.depth_m[:, ::-1])
    assert depth.confidence is not None and mirrored.confidence is not None
    assert np.array_equal(depth.confidence, mirrored.confidence[:, ::-1])


def test_exposure_does_not_matter() -> None:
    left, right, _ = scene()
    darker = (right * 0.9).astype(np.uint8) + np.uint8(10)
    before, after = IMAGES_ONLY(frame(left, right)), IMAGES_ONLY(frame(left, darker))
    assert np.mean(np.abs(after.depth_m / before.depth_m - 1) < 0.03) > 0.95


def test_colour_is_matched_as_grey() -> None:
    left, right, _ = scene()
    colour = IMAGES_ONLY(frame(np.dstack([left] * 3), np.dstack([right] * 3)))
    assert np.array_equal(colour.depth_m, IMAGES_ONLY(frame(left, right)).depth_m)


def test_same_input_gives_the_same_map() -> None:
    left, right, _ = scene()
    first, second = (IMAGES_ONLY(frame(left, right)).depth_m for _ in range(2))
    assert np.array_equal(first, second)


def test_offset_is_added_in_pixels() -> None:
    left, right, _ = scene()
    plain, moved = (Stereo(offset_px=offset)(frame(left, right)) for offset in (ZERO, (1.0, 0.0, 4.0)))
    X = (np.arange(320) - 160) / FX
    gained_px = FX * BASELINE_M / moved.depth_m - FX * BASELINE_M / plain.depth_m
    assert np.allclose(gained_px, 1 + 4 * X * X, atol=1e-3)


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (7, 5), (33, 17), (120, 397)])
def test_any_size(size: tuple[int, int]) -> None:
    image = texture(max(8, size[0]), max(8, size[1]))[: size[0], : size[1]].clip(0, 255).astype(np.uint8)
    depth = IMAGES_ONLY(frame(image, np.roll(image, -4, axis=1)))
    assert depth.depth_m.shape == size and depth.confidence is not None
    assert np.isfinite(depth.depth_m).all() and depth.depth_m.min() >= 0 and depth.depth_m.max() <= FARTHEST_M * 1.001


@pytest.mark.parametrize("image", [np.zeros((60, 90), np.uint8), np.full((60, 90, 3), 255, np.uint8)])
def test_nothing_to_match_gives_no_value(image: Any) -> None:
    depth = IMAGES_ONLY(frame(image, image))
    assert not depth.valid.any() and depth.confidence is not None and not depth.confidence.any()


def test_identical_images_are_infinitely_far() -> None:
    left, _, _ = scene()
    depth = IMAGES_ONLY(frame(left, left))
    assert not np.any(depth.valid & (depth.depth_m < 100))


def test_bad_input_is_named() -> None:
    left, right, _ = scene()
    with pytest.raises(DataError, match=r"frame 0: .*320x120 and 319x120"):
        IMAGES_ONLY(frame(left, right[:, 1:]))
    with pytest.raises(DataError, match="frame 0: the stereo baseline"):
        IMAGES_ONLY(frame(left, right, baseline_m=None))
    alone = frame(left, right, readers={"image": lambda: left}, missing={"other": "no image_03: download it"})
    with pytest.raises(DataError, match="frame 0: no image_03: download it"):
        IMAGES_ONLY(alone)
    with pytest.raises(DataError, match="expected a whole number from 1"):
        Stereo(max_disparity_px=0)


def test_resolve_without_lidar_is_what_the_rig_usually_has() -> None:
    left, right, _ = scene()
    assert Stereo().resolve(frame(left, right)) == Stereo(offset_px=ZERO, scale=1.0)
    made = frame(left, right, rig=KITTI)
    kitti, usual = Stereo().resolve(made), usual_error(KITTI, made.camera)
    assert (kitti.offset_px, kitti.scale) == (usual.offset_px, usual.scale) != (ZERO, 1.0)
    given = Stereo(offset_px=(1, 2, 3)).resolve(frame(left, right, rig=KITTI))
    assert (given.offset_px, given.scale) == ((1, 2, 3, 0), 1.0)
    with pytest.raises(DataError, match=r"--stereo\.offset-px 1 2 3 4 5: expected at most 4 numbers"):
        Stereo(offset_px=(1, 2, 3, 4, 5))


def test_a_correction_is_told(raw_drive: Path, tmp_path: Path) -> None:
    notes: list[str] = []
    method = Stereo(offset_px=(0.5, 0, 1.1), scale=0.981, max_disparity_px=16)
    job = build.prepare(open_drive(raw_drive), method, folder=tmp_path)
    job.run(job.plan(Selection(frames=":1")), on_note=notes.append)
    (note,) = notes
    assert "times 0.981, shift +0.50 px, tilt +0.00 px, yaw +1.10 px, pitch +0.00 px" in note and "\n" not in note
    assert not IMAGES_ONLY.notes()


def test_scale_multiplies_the_disparity() -> None:
    left, right = pair(20.0)
    plain, scaled = (Stereo(offset_px=ZERO, scale=scale)(frame(left, right)) for scale in (1.0, 0.98))
    np.testing.assert_allclose(scaled.depth_m, plain.depth_m / 0.98, rtol=1e-5)
    with pytest.raises(DataError, match=r"offset-px beside it"):
        Stereo(scale=0.98)


@pytest.mark.parametrize("side", ["left", "right"])
def test_resolve_measures_the_offset(side: Any) -> None:
    """A wall seen by stereo 0.6 px too far, and by the LiDAR where it is."""
    left, right = pair(20.0)
    columns, rows = np.meshgrid(np.arange(20, 300, 3.0), np.arange(10, 110, 3.0))
    depth_m = FX * BASELINE_M / 20.6
    xyz_m = np.stack([(columns - 160) / FX, (rows - 60) / FX, np.ones_like(rows)], axis=-1).reshape(-1, 3) * depth_m
    sweep = Sweep(xyz_m.astype(np.float32), None)
    image, other = (left, right) if side == "left" else (right, left)
    readers = {"image": lambda: image, "other": lambda: other, "sweep": lambda offset=0: sweep}
    made = frame(image, other, readers=readers, T_cam_lidar=np.eye(4), side=side)
    resolved = Stereo().resolve(made)
    assert resolved.offset_px is not None and resolved.scale is not None
    assert resolved.offset_px[0] == pytest.approx(0.6, abs=0.05)
    assert np.median(resolved(made).depth_m) == pytest.approx(depth_m, rel=0.01)


def road_and_walls() -> tuple[Camera, FloatMap, FloatMap]:
    """Return a camera, disparities of walls above a road, (120, 320) px, and their slope, px a row."""
    camera = Camera(np.array([[200, 0, 160], [0, 200, 60], [0, 0, 1.0]]), (120, 320))
    slope = np.zeros((120, 320), np.float32)
    slope[60:] = 0.3
    walls = np.where(np.arange(320) // 40 % 2, 20, 35).astype(np.float32)
    matched_px = walls + np.cumsum(slope, axis=0, dtype=np.float32)
    return camera, matched_px, slope


def test_the_usual_offset_is_of_the_images_size() -> None:
    """An image of a third of the size has a third of the offset, at the same place of the scene."""
    whole, third = (Camera(np.diag([size, size, 1.0]), (4, 4)) for size in (720.0, 240.0))
    expected = np.array(usual_error(KITTI, whole).offset_px) / 3
    assert usual_error(KITTI, third).offset_px == pytest.approx(expected, abs=1e-3)
    assert usual_error(KITTI, third).scale == usual_error(KITTI, whole).scale != 1
    assert usual_error(None, whole) == NONE


@pytest.mark.parametrize("rig", [None, KITTI])
def test_offset_has_a_curve_and_a_scale(rig: Rig | None) -> None:
    rng = np.random.default_rng(0)
    camera, matched_px, slope = road_and_walls()
    usual = usual_error(rig, camera)
    true = RectificationError(0.5, -0.2, 2.0, -1.0, 0.985)
    true_px = true.correct(matched_px, camera) + rng.normal(0, 0.1, slope.shape).astype(np.float32)
    found = fit(compare(camera, true_px, matched_px, slope), usual)
    assert found.offset_px == pytest.approx(true.offset_px, abs=0.05)
    assert found.scale == pytest.approx(true.scale, abs=0.002)
    assert fit(compare(camera, np.zeros_like(matched_px), matched_px, slope), usual) == usual


def test_offset_is_not_the_lidars_tilt() -> None:
    rng = np.random.default_rng(0)
    camera, matched_px, slope = road_and_walls()
    true_px = matched_px + 0.5 + 1.2 * slope + rng.normal(0, 0.1, slope.shape).astype(np.float32)
    found = fit(compare(camera, true_px, matched_px, slope))
    assert found.offset_px == pytest.approx((0.5, 0, 0, 0), abs=0.05)
    assert found.scale == pytest.approx(1, abs=0.003)


def test_offset_in_the_mirror() -> None:
    """Correcting a mirrored map by the mirrored offset is mirroring the corrected one."""
    camera, matched_px, _ = road_and_walls()
    K = camera.K.copy()
    K[0, 2] = 319 - K[0, 2]
    offset = RectificationError(0.5, -0.2, 2.0, -1.0, 0.985)
    mirrored = offset.mirrored().correct(matched_px[:, ::-1], Camera(K, camera.size))
    np.testing.assert_allclose(mirrored[:, ::-1], offset.correct(matched_px, camera), atol=1e-5)


def test_diffusion_keeps_a_plane_and_stops_at_an_edge() -> None:
    grey = np.full((60, 80), 100, np.uint8)
    grey[:, 40:] = 200
    disparity_px = np.where(np.arange(80) < 40, 10, 30).astype(np.float32) * np.ones((60, 1), np.float32)
    disparity_px[20:40, 20:60] = 0
    smooth_px, evidence = diffuse(disparity_px, grey)
    assert np.allclose(smooth_px[:, :40], 10, atol=0.05) and np.allclose(smooth_px[:, 40:], 30, atol=0.05)
    assert evidence[30, 30] < 0.5 < evidence[5, 30]


def test_far_from_matches_is_background() -> None:
    disparity_px = np.zeros((20, 600), np.float32)
    disparity_px[:, :5] = 3
    disparity_px[:, 5:40] = 30
    smooth_px, evidence = diffuse(disparity_px, np.full((20, 600), 90, np.uint8))
    assert smooth_px[10, 45] == pytest.approx(30, abs=0.1)
    assert smooth_px[10, 599] == pytest.approx(3, abs=0.1) and evidence[10, 599] < 1e-6


maps = arrays(np.float32, (7, 9), elements=st.sampled_from([0.0, 0.0, 1.0, 3.5, 9.0, 20.0]))
greys = arrays(np.uint8, (7, 9), elements=st.integers(0, 255))


@given(maps, greys)
@settings(max_examples=50, deadline=None)
def test_links_equal_reference(disparity_px: Any, grey: Any) -> None:
    ours, naive = link_columns(grey, disparity_px, 1.0, 8.0, 1.0), reference.link_columns(grey, disparity_px, 1.0, 8, 1)
    assert np.allclose(ours, naive, atol=0.02)


@given(maps, greys, st.floats(0.0, 100.0))
@settings(max_examples=50, deadline=None)
def test_diffusion_equals_reference(map_: Any, grey: Any, strength: float) -> None:
    links = link_columns(grey, map_, 1.0, 8.0, 1.0)
    first, second = map_.copy(), np.ones_like(map_)
    diffuse_columns(first, second, links, strength)
    assert np.allclose(first, reference.diffuse_columns(map_, links, strength), atol=1e-3)
    assert np.allclose(second, 1, atol=1e-4)


@given(maps)
@settings(max_examples=100, deadline=None)
def test_occlusions_equal_reference(disparity_px: Any) -> None:
    ours, naive = (
        fill_occlusions(disparity_px, 1.5, 0.2, 1.0, 0.05),
        reference.fill_occlusions(disparity_px, 1.5, 0.2, 1.0, 0.05),
    )
    assert np.allclose(ours[0], naive[0]) and np.allclose(ours[1], naive[1])


def score(depth: Depth, truth: Depth, share: float, by: str) -> tuple[float, float]:
    """AbsRel and RMSE (m) of the share of the truth's pixels that is most confident, or nearest."""
    assert depth.confidence is not None
    found_m, true_m = np.clip(depth.depth_m[truth.valid], 1e-3, 80), truth.depth_m[truth.valid]
    order = np.argsort(-depth.confidence[truth.valid] if by == "confidence" else found_m, kind="stable")
    kept = order[: round(share * order.size)]
    error_m = found_m[kept] - true_m[kept]
    return float(np.mean(np.abs(error_m) / true_m[kept])), float(np.sqrt(np.mean(error_m**2)))


@pytest.mark.parametrize("offset_px", [ZERO, None], ids=["images-only", "calibrated"])
def test_goal_on_drive_0001(offset_px: Any, real_data: Callable[..., Path]) -> None:
    path = real_data("kitti_raw", "2011_09_26", "2011_09_26_drive_0001_sync")
    drive = open_drive(path, options=DriveOptions(truth=real_data("kitti_depth")))
    method = Stereo(offset_px=offset_px).resolve(drive[0])
    rows = []
    for index in range(len(drive)):
        depth, truth = method(drive[index]), drive[index].truth()
        assert depth.valid[truth.valid].all()
        cases = [(1.0, "confidence"), (0.9228, "confidence"), (0.9228, "nearest")]
        rows.append([score(depth, truth, *case) for case in cases])
    whole, confident, nearest = np.mean(rows, axis=0)
    assert whole[0] <= 0.025 and whole[1] <= 1.6
    assert confident[0] <= 0.9 * whole[0] and confident[1] <= 0.75 * whole[1]
    assert np.all(confident <= nearest)
