"""Stereo by a network: what it is given, what comes back, and hard inputs; a stand-in takes the network's place."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from factories import scene as slanted
from hypothesis import given
from hypothesis import strategies as st
from standin import install
from test_stereo import BASELINE_M, FX, frame, pair, scene

from eval.files import write_bytes
from priors import build
from priors.codecs import FARTHEST_M
from priors.errors import DataError
from priors.methods import _stereo_network as network
from priors.methods import _stereo_size
from priors.methods.stereo import Stereo
from priors.nets import runtime, weights
from priors.types import Depth

ZERO = (0.0, 0.0, 0.0)
NET = Stereo(model="cfnet", runtime="fp32", resize="none", offset_px=ZERO)
MODELS = pytest.mark.parametrize("method", [NET, Stereo(offset_px=ZERO)], ids=["network", "classical"])


@pytest.fixture(autouse=True)
def standin(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    return install(monkeypatch, tmp_path / "weights", size="s")


def finite(depth: Depth, shape: tuple[int, int]) -> bool:
    """Tell whether a map has its frame's size, and only values that a map may have."""
    assert depth.confidence is not None
    good = np.isfinite(depth.depth_m).all() and np.isfinite(depth.confidence).all()
    good &= bool(depth.depth_m.min() >= 0 and depth.depth_m.max() <= FARTHEST_M * 1.001)
    good &= bool(depth.confidence.min() >= 0 and depth.confidence.max() <= 1)
    return bool(good) and depth.depth_m.shape == shape and not depth.confidence[depth.depth_m == 0].any()


def test_known_shift() -> None:
    depth = NET(frame(*pair(12.0)))
    disparity_px = FX * BASELINE_M / depth.depth_m
    assert np.median(np.abs(disparity_px - 12)[:, 40:-40]) < 0.1
    assert depth.density == 1 and finite(depth, (120, 320))


def test_range_comes_from_the_scene_in_steps_of_32() -> None:
    net: Any = runtime.open_net("cfnet", "s", "fp32").net
    for disparity_px, low, high in ((12.0, 32, 64), (45.0, 64, 96)):
        NET(frame(*pair(disparity_px)))
        assert low <= net.asked[-1] <= high and net.asked[-1] % 32 == 0
    Stereo(model="cfnet", runtime="fp32", resize="none", offset_px=ZERO, max_disparity_px=32)(frame(*pair(12.0)))
    assert net.asked[-1] == 64  # 0 to 32 are 33


def test_right_camera_is_the_left_one_in_the_mirror() -> None:
    left, right, _ = scene()
    mirrored = NET(frame(right[:, ::-1], left[:, ::-1]))
    depth = NET(frame(right, left, side="right"))
    assert np.array_equal(depth.depth_m, mirrored.depth_m[:, ::-1])
    assert depth.confidence is not None and mirrored.confidence is not None
    assert np.array_equal(depth.confidence, mirrored.confidence[:, ::-1])


def test_offset_is_added_in_pixels() -> None:
    left, right, _ = scene()
    plain, moved = (
        Stereo(model="cfnet", runtime="fp32", offset_px=offset)(frame(left, right)) for offset in (ZERO, (1.0, 0, 4.0))
    )
    X = (np.arange(320) - 160) / FX
    gained_px = FX * BASELINE_M / moved.depth_m - FX * BASELINE_M / plain.depth_m
    assert np.allclose(
        gained_px[plain.depth_m < 200], np.broadcast_to(1 + 4 * X * X, (120, 320))[plain.depth_m < 200], atol=1e-2
    )


def test_confidence_is_low_where_it_is_wrong() -> None:
    left, right, truth_px = scene()
    depth = NET(frame(left, right))
    assert depth.confidence is not None
    wrong = np.abs(FX * BASELINE_M / depth.depth_m - truth_px) > 1
    assert 0 < wrong.mean() < 0.3
    assert depth.confidence[wrong].mean() < depth.confidence[~wrong].mean() - 0.2


def test_empty_borders_are_left_out() -> None:
    left, right = (np.pad(view, ((8, 24), (16, 48))) for view in pair(12.0))
    assert network.busy(left, right) == (slice(8, 128), slice(16, 336))
    depth, whole = NET(frame(left, right)), NET(frame(*pair(12.0)))
    assert np.allclose(depth.depth_m[8:128, 16:336], whole.depth_m, rtol=1e-4)
    assert np.count_nonzero(depth.depth_m) == 120 * 320 and finite(depth, left.shape)


def test_large_pairs_are_halved(monkeypatch: pytest.MonkeyPatch) -> None:
    assert _stereo_size.count_halvings((375, 1242), 200) == 0
    assert _stereo_size.count_halvings((2056, 2464), 200) == 1
    assert _stereo_size.count_halvings((3000, 4000), 1000) == 2
    assert _stereo_size.count_halvings((375, 1242), 600) == 1
    monkeypatch.setattr(_stereo_size, "MOST_PIXELS", 120 * 320 - 1)
    net: Any = runtime.open_net("cfnet", "s", "fp32").net
    depth = Stereo(model="cfnet", runtime="fp32", resize="none", offset_px=ZERO, max_disparity_px=60)(
        frame(*pair(24.0))
    )
    assert net.asked[-1] == 32
    assert np.median(np.abs(FX * BASELINE_M / depth.depth_m - 24)[:, 60:-60]) < 0.3 and finite(depth, (120, 320))


def test_narrow_pairs_are_enlarged_and_others_are_not() -> None:
    net: Any = runtime.open_net("cfnet", "s", "fp32").net
    auto = replace(NET, resize="auto", max_disparity_px=60)
    depth = auto(frame(*pair(12.0)))
    assert net.asked[-1] == 192  # 60 px of 320 are 180 of 960
    assert np.median(np.abs(FX * BASELINE_M / depth.depth_m - 12)[:, 60:-60]) < 0.1 and finite(depth, (120, 320))
    assert auto.resolve(frame(*pair(12.0))).resize == "auto"
    wide = np.random.default_rng(0).integers(0, 256, (60, 950), dtype=np.uint8)
    assert auto.resolve(frame(wide, wide)).resize == "none", "it decides nothing there"
    auto(frame(wide, wide))
    assert net.asked[-1] == 64
    assert Stereo(resize="auto").resolve(frame(*pair(12.0))).resize == "none", "nor without a network"
    assert "resize" in Stereo().unread()


def test_wide_pairs_are_seen_smaller_where_time_counts() -> None:
    net: Any = runtime.open_net("cfnet", "s", "fp32").net
    fast = replace(NET, resize="fast", max_disparity_px=100)
    left, right = (np.tile(view, (1, 4, 1)[: view.ndim]) for view in pair(12.0))
    depth = fast(frame(left, right))
    assert net.asked[-1] == 96  # 85 px and one more
    off_px = np.abs(FX * BASELINE_M / depth.depth_m - 12)[:, 60:-60]
    assert np.median(off_px) <= 0.5 / 0.85, "the stand-in finds whole pixels"
    assert finite(depth, (120, 1280))
    assert fast.resolve(frame(left, right)).resize == "fast"
    assert fast.resolve(frame(*pair(12.0))).resize == "none"


def test_sizes_of_enlarged_pairs() -> None:
    assert [_stereo_size.factor_of(width, "auto") for width in (1, 333, 500, 950, 1242)] == [3, 3, 2, 1, 1]
    assert [_stereo_size.factor_of(width, "fast") for width in (1, 500, 1000, 1242)] == [1, 1, 1, 0.85]
    assert {_stereo_size.factor_of(width, "none") for width in (1, 500, 1242)} == {1}
    assert _stereo_size.seen_size((120, 414), 2.0, 100) == (240, 828)
    assert _stereo_size.seen_size((120, 400), 2.0, 200) == (192, 640), "320 disparities are searched at most"
    assert _stereo_size.seen_size((120, 400), 0.5, 500) == (60, 200)
    assert _stereo_size.seen_size((1, 1), 0.25, 1000) == (1, 1)


@given(st.floats(0.05, 20), st.floats(0.85, 3))
def test_a_chance_within_more_pixels(spread_px: float, pixels: float) -> None:
    """Laplace's distribution itself is the oracle."""
    chance = np.full((1, 1), -np.expm1(-1 / spread_px), np.float32)
    wanted = -np.expm1(-pixels / spread_px)
    assert _stereo_size.chance_in_pixels(chance, pixels)[0, 0] == pytest.approx(wanted, abs=1e-5)


@MODELS
@pytest.mark.parametrize("size", [(1, 64), (64, 1), (1, 1), (2, 3), (7, 5), (33, 17), (119, 397)])
def test_any_size(method: Stereo, size: tuple[int, int]) -> None:
    image = np.random.default_rng(0).integers(0, 256, size, dtype=np.uint8)
    assert finite(method(frame(image, np.roll(image, -4, axis=1))), size)


@MODELS
@pytest.mark.parametrize("shade", [0, 255])
def test_plain_images_have_no_value(method: Stereo, shade: int) -> None:
    image = np.full((60, 90, 3), shade, np.uint8)
    depth = method(frame(image, image))
    assert not depth.valid.any() and finite(depth, (60, 90))


@MODELS
def test_identical_images_are_far(method: Stereo) -> None:
    left, _, _ = scene()
    depth = method(frame(left, left))
    assert finite(depth, left.shape)
    assert not np.any(depth.valid & (depth.depth_m < 100))


def test_nothing_is_known_beyond_what_a_map_holds() -> None:
    left, _, _ = scene()
    depth = NET(frame(left, left))
    assert depth.valid.all() and depth.confidence is not None
    assert not depth.confidence[depth.depth_m > FARTHEST_M * 0.999].any()


@MODELS
def test_swapped_views_are_said(method: Stereo) -> None:
    left, right, _ = slanted((120, 320))
    assert finite(method(frame(left, right)), (120, 320))
    with pytest.raises(
        DataError, match=r"frame 0: left and right seem to be swapped: \d+% .* 9\d% the other way round"
    ):
        method(frame(right, left))
    with pytest.raises(DataError, match="swapped"):
        method(frame(left, right, side="right"))


@MODELS
@pytest.mark.parametrize(("baseline_m", "text"), [(-0.5, "is -0.5 m, expected above 0"), (float("nan"), "not known")])
def test_wrong_baselines_are_said(method: Stereo, baseline_m: float, text: str) -> None:
    left, right, _ = scene()
    with pytest.raises(DataError, match=f"frame 0: .*{text}"):
        method(frame(left, right, baseline_m=baseline_m))


@MODELS
def test_what_is_no_image_is_said(method: Stereo) -> None:
    empty, nan = np.zeros((0, 8), np.uint8), np.full((8, 8), np.nan, np.float32)
    for bad in (empty, nan):
        with pytest.raises(DataError, match=r"frame 0: an image is .*: expected uint8 pixels"):
            method(frame(bad, bad))


def test_twelve_million_pixels() -> None:
    small = np.random.default_rng(0).integers(0, 256, (300, 400), dtype=np.uint8)
    image = np.kron(small, np.ones((10, 10), np.uint8))
    method = Stereo(model="cfnet", runtime="fp32", resize="none", offset_px=ZERO, max_disparity_px=100)
    depth = method(frame(image, np.roll(image, -40, axis=1)))
    assert finite(depth, (3000, 4000))
    assert np.median(np.abs(FX * BASELINE_M / depth.depth_m - 40)) < 1


def test_the_key_holds_the_weights(standin: Path, tmp_path: Path) -> None:
    left, right, _ = scene()
    drive = Pairs(frame(left, right))
    classical = build.prepare(drive, Stereo(), folder=tmp_path).prior
    assert classical.manifest["weights"] is None
    first = build.prepare(drive, Stereo(model="cfnet", runtime="fp32"), folder=tmp_path).prior
    assert first.manifest["weights"] == weights.digest(standin)
    moved = tmp_path / "elsewhere" / standin.name
    moved.parent.mkdir()
    moved.write_bytes(standin.read_bytes())
    here, there = (
        build.prepare(drive, Stereo(model="cfnet", runtime="fp32", weights=path), folder=tmp_path).prior
        for path in (standin, moved)
    )
    assert here.folder == there.folder and here.manifest["config"]["weights"] == standin.name
    weights.rewrite_about(standin, steps=3)
    second = build.prepare(drive, Stereo(model="cfnet", runtime="fp32"), folder=tmp_path).prior
    assert len({classical.folder, first.folder, second.folder}) == 3


def test_options_of_networks_do_not_change_the_classical_key() -> None:
    left, right, _ = scene()
    assert Stereo(size="l", runtime="fp32").resolve(frame(left, right)) == Stereo().resolve(frame(left, right))
    assert Stereo(model="cfnet").resolve(frame(left, right)).runtime == runtime.choose("auto")


def test_weights_need_a_network() -> None:
    with pytest.raises(DataError, match=r"a.safetensors: which network"):
        Stereo(weights=Path("a.safetensors"))
    left, right, _ = scene()
    with pytest.raises(DataError, match="no weights for pcwnet in size s"):
        Stereo(model="pcwnet", runtime="fp32")(frame(left, right))


def test_onnx_gives_the_same_depth(tmp_path: Path) -> None:
    from priors.nets.export import to_onnx

    left, right, _ = scene()
    exact = Stereo(model="cfnet", runtime="fp32", resize="none", offset_px=ZERO, max_disparity_px=60)(
        frame(left, right)
    )
    file = tmp_path / "a.onnx"
    write_bytes(file, to_onnx(runtime.open_net("cfnet", "s", "onnx"), (128, 320), 64))
    for method in (
        Stereo(model="cfnet", runtime="onnx", resize="none", offset_px=ZERO, max_disparity_px=60),
        Stereo(model="cfnet", weights=file, offset_px=ZERO),
    ):
        depth = method(frame(left, right))
        assert np.mean(np.abs(depth.depth_m / exact.depth_m - 1) < 0.01) > 0.98


class Pairs:
    """A drive of one frame."""

    name = "pairs"
    ids = ("0",)

    def __init__(self, made: Any) -> None:
        self.made = made

    def describe(self) -> dict[str, Any]:
        return {}

    def fingerprint(self) -> str:
        return "-"

    def __len__(self) -> int:
        return 1

    def __getitem__(self, index: int) -> Any:
        return self.made
