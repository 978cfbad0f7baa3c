"""Training pairs: their truth stays the truth, whatever is done to them."""

from dataclasses import replace
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from conftest import RealData
from reference import disparity_warp as slow

from priors.codecs import as_rgb
from priors.errors import DataError
from priors.kernels import disparity_warp as kernels
from priors.learn import pair_file, pseudo_labels, stereo_augment, teacher_labels, teacher_maps, warp, warp_scenes
from priors.learn.eye_views import EyeView, read_views
from priors.learn.stereo_data import Folders, collate, find_sources, mixture, split_frames, validation
from priors.learn.stereo_pair import Sensors, StereoPair, mirror
from priors.pairs.matching import match
from priors.types import Camera

SIZE = (96, 192)


def texture(y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """A pattern without steps, of any place: grey levels."""
    waves = [np.sin(0.31 * x + 0.11 * y + 1), np.sin(0.13 * x - 0.23 * y), np.sin(0.53 * x + 0.05 * y + 2)]
    return 128 + 30 * waves[0] + 40 * waves[1] + 20 * waves[2]


def slanted(size: tuple[int, int] = SIZE, a: float = 7.3, b: float = 0.04, c: float = 0.06) -> StereoPair:
    """An exact pair of a slanted plane: disparity a + b x + c y."""
    y, x = np.mgrid[: size[0], : size[1]].astype(np.float64)
    left = texture(y, x)
    right = texture(y, (x + a + c * y) / (1 - b))
    views = [np.repeat(np.rint(view).astype(np.uint8)[..., None], 3, axis=2) for view in (left, right)]
    disparity_px = (a + b * x + c * y).astype(np.float32)
    return StereoPair(*views, disparity_px, np.zeros(size, bool), np.ones(size, np.float32), "test")


def mismatch(pair: StereoPair) -> np.ndarray:
    """Grey levels by which the right view, looked up where the truth says, differs from the left: where it can be."""
    height, width = pair.disparity_px.shape
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    there = columns - pair.disparity_px
    warped = cv2.remap(pair.right, there, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    inside = pair.known & (there >= 2) & (columns < width - 2) & (rows >= 2) & (rows < height - 2)
    difference = np.abs(warped.astype(float) - pair.left)
    return (difference if difference.ndim == 2 else difference.max(axis=2))[inside]


@pytest.mark.parametrize("seed", range(6))
def test_a_cut_window_has_the_truth_of_its_own_scale(seed: int) -> None:
    wild = replace(stereo_augment.REAL, zoom=0.4, stretch=0.3)
    cut = stereo_augment.cut(slanted(), np.random.default_rng(seed), (64, 128), wild)
    assert cut.left.shape == (64, 128, 3) and cut.known.all()
    assert mismatch(cut).max() < 6
    shifted = replace(cut, disparity_px=cut.disparity_px + np.float32(0.3))
    assert mismatch(shifted).mean() > 1.5 * mismatch(cut).mean()


def test_a_resized_plane_is_the_plane_of_the_new_pixels() -> None:
    pair = slanted()
    out = stereo_augment.resize(pair, 10, 30, (60, 100), (90, 250))
    y = 10 + (np.arange(90) + 0.5) * 60 / 90 - 0.5
    x = 30 + (np.arange(250) + 0.5) * 100 / 250 - 0.5
    expected = 2.5 * (7.3 + 0.04 * x + 0.06 * y[:, None])
    assert np.abs(out.disparity_px - expected)[2:-2, 2:-2].max() < 1e-3


def test_resizing_mixes_neither_surfaces_nor_flags() -> None:
    rng = np.random.default_rng(3)
    values = rng.choice(np.array([0, 12.5, 40], np.float32), (20, 30))
    flags = (values > 0).astype(np.uint8)
    out, kinds = kernels.resize(values, flags, 2, 3, (15, 20), (33, 41), 1.0)
    assert set(np.unique(out)) <= {0, 12.5, 40}
    assert np.array_equal(kinds == 1, out > 0)


def test_resizing_is_what_opencv_does_inside_a_surface() -> None:
    y, x = np.mgrid[:20, :30].astype(np.float32)
    values = (0.3 * x + 0.2 * y + 0.05 * np.sin(x)).astype(np.float32)
    out, _ = kernels.resize(values, np.ones((20, 30), np.uint8), 2, 3, (15, 20), (33, 41), 1.0)
    expected = cv2.resize(values[2:17, 3:23], (41, 33), interpolation=cv2.INTER_LINEAR)
    assert np.abs(out - expected).max() < 1e-4


def test_depth_and_intrinsics_follow_the_window() -> None:
    K = np.array([[100.0, 0, 90], [0, 100, 40], [0, 0, 1]])
    points = np.ones((3, 3), np.float32), np.zeros(3, np.uint8)
    before = replace(slanted(), sensors=Sensors(Camera(K, SIZE), 0.5, *points))
    after = stereo_augment.resize(before, 10, 30, (60, 100), (90, 250))
    assert after.depth_m[45, 120] == pytest.approx(before.depth_m[40, 78], rel=0.01)
    point = np.array([0.3, 0.1, before.depth_m[40, 78]])
    u, v = (K @ point)[:2] / point[2]
    assert after.sensors is not None
    moved_u, moved_v = (after.sensors.camera.K @ point)[:2] / point[2]
    assert moved_u == pytest.approx((u - 30 + 0.5) * 2.5 - 0.5) and moved_v == pytest.approx((v - 10 + 0.5) * 1.5 - 0.5)


def test_a_misaligned_right_view_moves_nothing_along_its_rows() -> None:
    columns = np.tile(np.arange(180, dtype=np.uint8), (60, 1))
    assert np.array_equal(stereo_augment.misalign(columns, 0.7, 0.01), columns)
    rows = np.ascontiguousarray(columns[:, :60].T)
    moved = stereo_augment.misalign(rows, 1.0, 0.0)
    assert np.array_equal(moved[5:50], rows[6:51])


def test_what_the_right_view_sees_is_what_the_slow_loop_finds() -> None:
    rng = np.random.default_rng(5)
    for _ in range(15):
        smooth = np.cumsum(rng.uniform(-0.5, 0.5, (3, 40)), axis=1) + 8
        steps = np.repeat(rng.choice([0.0, 0.0, 5.3, 11.7], (3, 8)), 5, axis=1)
        disparity_px = np.maximum(smooth + steps, 0).astype(np.float32)
        column, seen_px = kernels.see_right(disparity_px, 0.8)
        expected_column, expected_px = slow.see_right(disparity_px, 0.8)
        # A pixel on the very end of a piece may fall on either side of rounding.
        differs = np.abs(seen_px - expected_px) > 1e-3
        assert differs.mean() < 0.01
        assert np.abs(column - expected_column)[~differs].max() < 1e-3


def blocks(size: tuple[int, int] = SIZE) -> warp.DisparityImage:
    """A slanted ground with a near block on it, under a textured sky."""
    y, x = np.mgrid[: size[0], : size[1]].astype(np.float32)
    disparity_px = np.maximum(0.25 * (y - 30) + 0.02 * x, 2).astype(np.float32)
    disparity_px[30:70, 90:130] = 24.4
    sky = y < 20
    disparity_px[sky] = 0
    image = np.repeat(np.rint(texture(y, x)).astype(np.uint8)[..., None], 3, axis=2)
    return warp.DisparityImage(image, disparity_px, sky)


def reproduced(pair: StereoPair) -> None:
    """Where the right view sees the same surface, the truth reproduces the left view; elsewhere it hides it."""
    _, seen_px = kernels.see_right(pair.disparity_px, warp.STEP_PX)
    height, width = pair.disparity_px.shape
    rows, columns = np.mgrid[:height, :width]
    there = np.clip(np.rint(columns - pair.disparity_px).astype(int), 0, width - 1)
    hidden = seen_px[rows, there] > pair.disparity_px + 0.5
    edge = cv2.dilate(pair.disparity_px, np.ones((3, 7))) - cv2.erode(pair.disparity_px, np.ones((3, 7))) > 1.5
    clear = replace(pair, weight=pair.weight * (~hidden & ~edge))
    assert clear.known.mean() > 0.7
    assert np.quantile(mismatch(clear), 0.995) < 6
    wrong = replace(clear, disparity_px=clear.disparity_px + np.float32(0.5))
    assert mismatch(wrong).mean() > 2 * mismatch(clear).mean()


def test_a_warped_image_has_the_disparities_it_was_made_with() -> None:
    filler = np.random.default_rng(0).integers(0, 255, (50, 60, 3), dtype=np.uint8)
    pair = warp.warp(blocks(), filler)
    assert np.array_equal(pair.left, blocks().image) and pair.known.all()
    reproduced(pair)


def test_the_mirrored_pair_of_a_warped_image_is_as_true() -> None:
    pair = warp.warp(blocks(), np.zeros((50, 60), np.uint8), swap=True)
    assert np.array_equal(pair.right, blocks().image[:, ::-1])
    assert not pair.known.all() and pair.sky[:18].mean() > 0.95
    reproduced(pair)


def test_a_whole_number_of_pixels_is_a_plain_shift() -> None:
    image = np.random.default_rng(1).integers(0, 255, SIZE, dtype=np.uint8)
    scene = warp.DisparityImage(image, np.full(SIZE, 9, np.float32), np.zeros(SIZE, bool))
    right = warp.warp(scene, np.zeros(SIZE, np.uint8)).right
    assert np.array_equal(right[:, :-9], image[:, 9:])


def test_the_near_hides_the_far_and_holes_are_filled() -> None:
    image = np.full(SIZE, 50, np.uint8)
    image[30:60, 80:120] = 200
    disparity_px = np.full(SIZE, 2, np.float32)
    disparity_px[30:60, 80:120] = 20
    rng = np.random.default_rng(1)
    scene = warp.DisparityImage(image, disparity_px, np.zeros(SIZE, bool))
    pair = warp.warp(scene, rng.integers(0, 255, SIZE, dtype=np.uint8))
    assert (pair.right[31:59, 61:99] == 200).all()
    assert np.std(pair.right[31:59, 101:117]) > 10  # what neither view saw: another image
    assert (pair.right[5:25, :180] == 50).all()


def test_exchanging_the_views_twice_gives_the_first_pair() -> None:
    pair = slanted()
    y, u = np.mgrid[: SIZE[0], : SIZE[1]]
    right_px = ((u + 7.3 + 0.06 * y) / 0.96 - u).astype(np.float32)
    turned = mirror(pair, right_px, pair.known, pair.sky)
    assert mismatch(turned).max() < 6


def test_smeared_edges_become_sharp() -> None:
    step = np.full((40, 60), 5, np.float32)
    step[:, 30:] = 45
    smeared = cv2.blur(step, (7, 1))
    sharp = warp.sharpen(smeared)
    assert set(np.unique(np.round(sharp))) <= {5, 6, 44, 45}
    plane = np.tile(np.linspace(3, 40, 60, dtype=np.float32), (40, 1))
    assert np.array_equal(warp.sharpen(plane), plane)


def test_a_layout_stands_on_its_ground() -> None:
    labels = np.full((180, 240), warp_scenes.BUILDING, np.uint8)
    labels[:60] = warp_scenes.SKY
    labels[110:] = warp_scenes.ROAD
    labels[90:150, 100:130] = 8
    disparity_px = warp_scenes.lay_out(labels, np.random.default_rng(0))
    assert (disparity_px[:60] == 0).all()
    assert (np.diff(disparity_px[110:, 10]) > 0).all()
    assert disparity_px[120, 115] == pytest.approx(disparity_px[149, 20], abs=1e-3)
    assert np.abs(disparity_px[60:110, 10] - disparity_px[109, 10]).max() < 1e-6


def write_street(folder: Path, worlds: int = 4) -> Path:
    """A folder as `priors train samples` leaves it, of two samples a world."""
    for world in range(worlds):
        for number in (24 * world, 24 * world + 1):
            pair = slanted((64, 128), a=5 + world)
            sky = np.zeros((64, 128), bool)
            sky[:9] = True
            camera = Camera(np.array([[90.0, 0, 64], [0, 90, 32], [0, 0, 1]]), (64, 128))
            disparity_px = np.where(sky, np.float32(0), pair.disparity_px)
            sensors = Sensors(camera, 0.5, np.ones((3, 3), np.float32), np.zeros(3, np.uint8))
            rendered = replace(pair, disparity_px=disparity_px, sky=sky, source="street", sensors=sensors)
            pair_file.write(folder / f"{number:06d}.npz", rendered)
    return folder


def test_the_mixture_follows_from_the_generator(tmp_path: Path) -> None:
    draw = mixture(Folders(write_street(tmp_path)), (48, 96))
    first, again, other = (draw(np.random.default_rng([7, step])) for step in (1, 1, 2))
    for field in ("left", "right", "disparity_px", "sky", "weight"):
        assert np.array_equal(getattr(first, field), getattr(again, field))
    assert not np.array_equal(first.left, other.left)


def test_batches_are_what_networks_want(tmp_path: Path) -> None:
    draw = mixture(Folders(write_street(tmp_path)), (48, 96))
    pairs = [draw(np.random.default_rng(step)) for step in range(12)]
    assert {pair.left.ndim for pair in pairs} == {2, 3}  # grey and coloured
    for pair in pairs:
        assert pair.left.shape[:2] == (48, 96) and pair.left.shape == pair.right.shape
        assert (pair.disparity_px[~pair.known] == 0).all() and (pair.disparity_px[pair.known & ~pair.sky] > 0).all()
        assert (pair.disparity_px[pair.sky] == 0).all() and pair.known[pair.sky].all()
    batch = collate(pairs)
    assert batch["left"].shape == (12, 3, 48, 96) and batch["left"].min() >= 0 and batch["left"].max() <= 1
    assert batch["left"].is_contiguous(memory_format=torch.channels_last)
    for one, tensor in zip(pairs, batch["right"], strict=True):
        assert np.array_equal(np.rint(255 * tensor.permute(1, 2, 0).numpy()), as_rgb(one.right))
    assert all(value.dtype == torch.float32 for value in batch.values())


def test_what_is_validated_on_is_never_drawn(tmp_path: Path) -> None:
    train, held = find_sources(Folders(write_street(tmp_path)))
    assert [path.stem for path in held.street] == ["000072", "000073"]
    assert not set(train.street) & set(held.street)
    pair = validation(Folders(tmp_path))[0]
    assert pair.left.shape == (64, 128, 3)
    assert np.allclose(pair.disparity_px[9:], slanted((64, 128), a=8).disparity_px[9:], atol=0.003)


def test_both_views_of_every_tenth_frame_are_held_back() -> None:
    paths = [Path(f"06_{n:06d}{side}.npz") for n in range(21) for side in ("", "_right")]
    train, held = split_frames(paths)
    assert {path.stem[:9] for path in held} == {"06_000000", "06_000010", "06_000020"} and len(held) == 6
    assert len(train) == 36


def real_like() -> tuple[StereoPair, np.ndarray]:
    """A pair with texture that a matcher can match, and what it is matched to."""
    rng = np.random.default_rng(2)
    size = (160, 320)
    image = cv2.GaussianBlur(rng.integers(0, 255, size, dtype=np.uint8), (0, 0), 1.2)
    y = np.mgrid[: size[0], : size[1]].astype(np.float32)[0]
    scene = warp.DisparityImage(cv2.normalize(image, None, 0, 255, cv2.NORM_MINMAX), 12 + 0.1 * y, np.zeros(size, bool))
    pair = warp.warp(scene, np.zeros(size, np.uint8))
    return pair, match(pair.left, pair.right)


def test_labels_are_right_and_a_teachers_offset_is_taken_off() -> None:
    pair, matched_px = real_like()
    x = np.arange(320)
    teacher_px = pair.disparity_px + (0.4 + 1.0 * (2 * x / 320 - 1) ** 2).astype(np.float32)
    alone = pseudo_labels.label(pair.left, pair.right, matched_px)
    taught = pseudo_labels.label(pair.left, pair.right, matched_px, teacher_px)
    for found in (alone, taught):
        assert found.known.mean() > 0.6
        assert np.quantile(np.abs(found.disparity_px - pair.disparity_px)[found.known], 0.99) < 0.5
    assert alone.weight.max() == pytest.approx(pseudo_labels.ALONE)
    assert np.median(taught.weight[taught.known]) == pytest.approx(pseudo_labels.BOTH)


def test_a_teacher_that_disagrees_is_not_believed() -> None:
    pair, matched_px = real_like()
    teacher_px = pair.disparity_px.copy()
    teacher_px[60:100, 100:200] += 6
    assert pseudo_labels.label(pair.left, pair.right, matched_px, teacher_px).known[64:96, 110:190].mean() < 0.05
    matched_px[60:100, 100:200] = 0  # nor where nothing speaks against it but the image
    assert pseudo_labels.label(pair.left, pair.right, matched_px, teacher_px).known[64:96, 110:190].mean() < 0.1


def test_a_bright_wall_is_no_sky() -> None:
    mask = np.zeros((60, 100), np.uint8)
    mask[5:25, 10:40] = mask[5:25, 60:90] = 1
    matched_px = np.full((60, 100), 30, np.float32)
    matched_px[:, 50:] = 3
    matched_px[mask > 0] = 0
    kept = pseudo_labels.reaching_far(mask, matched_px)
    assert kept[10, 70] == 1 and kept[10, 20] == 0


def test_a_labelled_pair_and_a_scene_come_back_from_disk(tmp_path: Path) -> None:
    pair, matched_px = real_like()
    labelled = pseudo_labels.label(pair.left, pair.right, matched_px)
    pair_file.write(tmp_path / "a.npz", labelled, matched_px)
    back = pair_file.read(tmp_path / "a.npz")
    assert np.abs(back.disparity_px - labelled.disparity_px).max() <= 0.5 / 256 + 1e-6
    assert np.array_equal(back.known, labelled.known) and np.array_equal(back.right, labelled.right)
    assert np.abs(back.weight - labelled.weight).max() <= 0.5 / 255 + 1e-6 and back.source == labelled.source
    assert np.abs(pair_file.read_matched(tmp_path / "a.npz") - matched_px).max() <= 0.5 / 256 + 1e-6
    pair_file.write_image(tmp_path / "b.npz", blocks())
    scene = pair_file.read_disparity_image(tmp_path / "b.npz")
    assert np.array_equal(scene.image, blocks().image) and np.array_equal(scene.sky, blocks().sky)
    assert np.array_equal(pair_file.read_left(tmp_path / "b.npz"), blocks().image)


def test_a_rendered_pair_comes_back_with_its_sensors(tmp_path: Path) -> None:
    write_street(tmp_path, worlds=1)
    back = pair_file.read(tmp_path / "000000.npz")
    assert back.source == "street" and back.sensors is not None
    assert back.sensors.camera.K[0, 2] == 64 and back.sensors.camera.size == (64, 128)
    assert back.sensors.baseline_m == 0.5 and back.sensors.points_m.shape == (3, 3)
    assert np.array_equal(back.weight, np.ones((64, 128), np.float32)) and back.sky[:9].all() and not back.sky[9:].any()
    with np.load(tmp_path / "000000.npz") as file:
        assert "weight" not in file  # a plain one takes no room


def test_files_of_older_layouts_and_damaged_ones_are_one_line(tmp_path: Path) -> None:
    old = tmp_path / "samples" / "000000.npz"
    old.parent.mkdir()
    np.savez(old, left=np.zeros((4, 5), np.uint8), disparity=np.zeros((4, 5), np.uint16))
    cut = tmp_path / "000001.npz"
    pair_file.write(cut, slanted())
    cut.write_bytes(cut.read_bytes()[:5000])
    for path, reason in (
        (old, "older layout: delete .*samples/ and run"),
        (cut, "damaged"),
        (tmp_path / "no.npz", "No such"),
    ):
        with pytest.raises(DataError, match=reason) as caught:
            pair_file.read(path)
        assert "\n" not in str(caught.value)
    with pytest.raises(DataError, match="damaged"):
        pair_file.write_image(cut, blocks())
        pair_file.read(cut)  # no right view


def test_a_teachers_map_of_another_size_is_an_error(tmp_path: Path) -> None:
    np.save(tmp_path / "06_000000.npy", np.zeros((4, 5), np.float32))
    with pytest.raises(DataError, match="teach again"):
        teacher_maps.read_map(tmp_path / "06_000000.npy", (4, 6))


PEER = """
import torch
class Shift(torch.nn.Module):
    def forward(self, left, right):
        assert left.shape[-1] % 32 == 0 and left.shape[-2] % 32 == 0
        place = torch.arange(left.shape[-1], dtype=torch.float32)
        return place.expand(left.shape[0], left.shape[-2], -1)
"""


def test_a_peer_teaches_in_each_eyes_own_pixels(tmp_path: Path) -> None:
    (tmp_path / "peer.py").write_text(PEER)
    torch.save({"state_dict": {}}, tmp_path / "weights.tar")
    net = teacher_labels.load(tmp_path / "peer.py", "Shift", tmp_path / "weights.tar")
    image = np.zeros((40, 70), np.uint8)
    left = teacher_labels.predict(net, EyeView("06", "000000", "left", image, image))
    right = teacher_labels.predict(net, EyeView("06", "000000", "right", image, image))
    assert left.shape == (40, 70) and np.array_equal(left[3], np.arange(70)) and np.array_equal(right, left[:, ::-1])
    with pytest.raises(DataError, match="--network"):
        teacher_labels.load(tmp_path / "peer.py", "Other", tmp_path / "weights.tar")


def test_right_eyes_see_the_mirrored_pair(real_data: RealData) -> None:
    first, second = islice(read_views(real_data("kitti_odometry", "sequences", "06")), 2)
    assert (first.name, second.name) == ("06_000000", "06_000000_right")
    assert np.array_equal(second.left, first.right[:, ::-1]) and np.array_equal(second.right, first.left[:, ::-1])
