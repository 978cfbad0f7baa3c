"""Mono: the focal convention, planes, what may take part in adapting, and hard inputs."""

import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from guarded import GuardedDrive
from hypothesis import given, settings
from hypothesis import strategies as st

from priors import build
from priors.adapt.depth_supervision import DepthSupervision
from priors.adapt.finetune import AdaptConfig, fine_tune
from priors.adapt.objective import loss, nearest_of_cells, silog
from priors.adapt.training_frames import pick_evenly, training_views
from priors.adapt.views import SKY, SURFACE, LabelledView
from priors.adapt.windows import random_crop
from priors.errors import DataError
from priors.methods._reference import READS
from priors.methods.mono import Mono
from priors.nets import bts, weights
from priors.owner import claim
from priors.types import Camera, Depth, Frame

HEIGHT_M = 1.65


def intrinsics(focal_px: float, size: tuple[int, int]) -> np.ndarray:
    return np.array([[focal_px, 0, (size[1] - 1) / 2], [0, focal_px, 0.4 * size[0]], [0, 0, 1.0]])


def road(focal_px: float = 200.0, size: tuple[int, int] = (64, 160), seed: int = 0) -> LabelledView:
    """A flat road seen from HEIGHT_M above it, under a sky: brightness follows disparity, plus noise."""
    K = intrinsics(focal_px, size)
    below_px = np.arange(size[0]) - K[1, 2]
    row_m = np.where(below_px > 1, focal_px * HEIGHT_M / np.maximum(below_px, 1), 0)
    depth_m = np.repeat(row_m[:, None], size[1], axis=1).astype(np.float32)
    sky = np.repeat((below_px < 0)[:, None], size[1], axis=1)
    noise = np.random.default_rng(seed).uniform(0, 40, (*size, 3))
    grey = np.where(sky, 200, 40 + 2 * np.maximum(below_px, 0)[:, None])
    image = np.clip(grey[..., None] + noise, 0, 255).astype(np.uint8)
    return LabelledView(image, Camera(K, size), depth_m, np.where(sky, SKY, SURFACE).astype(np.int8), "road")


@dataclass
class Road(GuardedDrive):
    """A drive of such views."""

    size: tuple[int, int] = (64, 160)

    def __getitem__(self, index: int) -> Frame:
        view = road(size=self.size, seed=index)
        rows = np.flatnonzero(view.depth_m[:, 0] > 0)[::3]
        sparse_m = np.zeros_like(view.depth_m)
        sparse_m[rows] = view.depth_m[rows]
        readers = {
            "image": self.reader(index, lambda: view.image),
            "sparse": self.reader(index, lambda: Depth(sparse_m)),
        }
        return Frame(self.ids[index], view.camera, readers, {"sweep": "this drive has no LiDAR"})


@pytest.fixture(scope="module")
def net() -> bts.Bts:
    torch.manual_seed(0)
    made = bts.Bts("s").eval()
    with torch.no_grad():  # heads start at 0; a network that says something needs more
        for layer in (made.coarse[1], made.fine[1], made.mix):
            layer.weight.normal_(std=0.3)
    return made


@pytest.fixture
def file(net: bts.Bts, tmp_path: Path) -> Path:
    path = tmp_path / "mine.safetensors"
    weights.write(path, net, {"net": "bts", "size": "s"})
    return path


def run(net: bts.Bts, image: np.ndarray, K: np.ndarray) -> bts.MonoOut:
    with torch.inference_mode():
        return net(torch.from_numpy(image).permute(2, 0, 1)[None].float() / 255, torch.from_numpy(K).float()[None])


@pytest.mark.parametrize("factor", [0.5, 2.0, 3.7])
def test_depth_follows_the_focal_length(net: bts.Bts, factor: float) -> None:
    """The same picture through `factor` times the focal length is of a scene that is `factor` times as deep."""
    image = road().image
    K = intrinsics(200.0, (64, 160))
    longer = K.copy()
    longer[:2, :2] *= factor
    one, other = run(net, image, K), run(net, image, longer)
    torch.testing.assert_close(other.depth_m, one.depth_m * factor, rtol=1e-5, atol=0)
    torch.testing.assert_close(other.coarse_m, one.coarse_m * factor, rtol=1e-5, atol=0)
    torch.testing.assert_close(other.sky_logit, one.sky_logit)
    assert one.depth_m.std() > 0.005 * one.depth_m.mean()  # it does say something


def test_the_network_sees_where_a_crop_was_cut() -> None:
    """A pixel's place is relative to the principal point: a crop with its own K has the places of the whole image."""
    K = torch.tensor([[[700.0, 0, 80], [0, 650, 30], [0, 0, 1]]])
    moved = K.clone()
    moved[:, :2, 2] -= torch.tensor([17.0, 9.0])
    whole = bts.places(K, torch.zeros(1, 3, 64, 160))
    torch.testing.assert_close(bts.places(moved, torch.zeros(1, 3, 40, 100)), whole[:, :, 9:49, 17:117])
    # The ground is at fy H / (v - cy); in the network's units, whatever fx and fy, at 4 H / y.
    ground_m = 650 * HEIGHT_M / (50 - 30)
    assert ground_m * bts.FOCAL_PX / 700 == pytest.approx(4 * HEIGHT_M / float(whole[0, 1, 50, 0]), rel=1e-5)


@given(seed=st.integers(0, 10**6), a=st.floats(-1, 1), b=st.floats(-1, 1))
@settings(max_examples=20, deadline=None)
def test_planes_come_back_exactly(seed: int, a: float, b: float) -> None:
    """Cells that agree on one plane in inverse depth give that plane, whatever the weights."""
    torch.manual_seed(seed)
    height, width, k = 5, 7, 4
    v, u = torch.meshgrid(torch.arange(height * k).float(), torch.arange(width * k).float(), indexing="ij")
    wanted = 0.2 + 0.002 * (a * u + b * v)
    middle = wanted.view(height, k, width, k).mean((1, 3))
    slopes = torch.stack([0.002 * k * a / middle, 0.002 * k * b / middle])
    sky = torch.full((1, 1, height, width), 3.0)
    out = bts.upsample(middle[None, None], slopes[None], sky, torch.randn(1, 9 * k * k, height, width), k)
    inner = (slice(k, -k), slice(k, -k))  # at the rim, cells outside the image repeat those inside
    torch.testing.assert_close(out[0, 0][inner], wanted[inner], rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(out[0, 1], torch.full_like(out[0, 1], 3.0))


def test_no_plane_vanishes() -> None:
    steep = bts.STEEPEST_QUARTER * torch.tensor([[1.0, -1.0, 1.0, -1.0], [1.0, 1.0, -1.0, -1.0]])
    slopes = steep.reshape(1, 2, 2, 2)
    for neighbour in range(9):
        logits = torch.full((1, 9, 16, 2, 2), -30.0)
        logits[:, neighbour] = 30.0
        out = bts.upsample(torch.ones(1, 1, 2, 2), slopes, torch.zeros(1, 1, 2, 2), logits.view(1, 144, 2, 2), 4)
        assert out[:, 0].min() > 0
    assert bts.tilt(bts.STEEPEST_EIGHTH * torch.ones(1, 2, 1, 1), 2).min() > 0


@pytest.mark.parametrize("size", [(1, 1), (33, 31), (20, 300), (90, 40)])
@pytest.mark.parametrize("value", [0, 255, None])
def test_any_size_and_any_image(net: bts.Bts, size: tuple[int, int], value: int | None) -> None:
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (*size, 3)).astype(np.uint8) if value is None else np.full((*size, 3), value, np.uint8)
    out = run(net, image, intrinsics(300.0, size))
    for map_ in (out.depth_m, out.sky_logit, out.log_scale):
        assert map_.shape == (1, *size)
        assert torch.isfinite(map_).all()
    assert (out.depth_m > 0).all()
    assert out.coarse_m.shape == (1, -(-size[0] // 4), -(-size[1] // 4))


@given(seed=st.integers(0, 10**6), zoom=st.floats(0.5, 2.0))
@settings(max_examples=40, deadline=None)
def test_crops_keep_the_camera_true(seed: int, zoom: float) -> None:
    """Of a flat road, depth x rows below the horizon / fy stays the camera's height, in any crop at any scale."""
    view = random_crop(road(size=(96, 200)), np.random.default_rng(seed), (64, 96), (zoom, zoom))
    assert view.image.shape == (64, 96, 3)
    K = view.camera.K
    below_px = (np.arange(64) - K[1, 2])[:, None] * np.ones(96)
    known = (view.depth_m > 0) & (below_px > 8)
    heights_m = (view.depth_m * below_px / K[1, 1])[known]
    assert heights_m == pytest.approx(HEIGHT_M, rel=0.15)  # nearest-neighbour resizing is half a pixel off
    if known.sum() > 500:
        assert np.mean(heights_m) == pytest.approx(HEIGHT_M, rel=0.04)


def test_silog_by_hand() -> None:
    known = torch.ones(1, 4, 4, dtype=torch.bool)
    assert float(silog(torch.full((1, 4, 4), 0.2), known)) == pytest.approx(10 * 0.2 * np.sqrt(0.15), rel=1e-4)
    mixed = torch.tensor([[[0.3, -0.1]]])
    by_hand = 10 * np.sqrt((0.09 + 0.01) / 2 - 0.85 * 0.1**2)
    assert float(silog(mixed, torch.ones(1, 1, 2, dtype=torch.bool))) == pytest.approx(by_hand, rel=1e-4)


def test_nearest_of_cells() -> None:
    depth_m = torch.zeros(1, 5, 8)
    depth_m[0, 0, 1], depth_m[0, 3, 3], depth_m[0, 4, 7] = 10.0, 4.0, 7.0
    torch.testing.assert_close(nearest_of_cells(depth_m), torch.tensor([[[4.0, 0.0], [0.0, 7.0]]]))


@pytest.mark.parametrize("known", [True, False])
def test_losses_are_finite_without_truth(known: bool) -> None:
    net = bts.Bts("s").eval()
    depth_m = torch.full((1, 40, 64), 10.0 if known else 0.0)
    batch = {"depth_m": depth_m, "sky": torch.full((1, 40, 64), -1.0)}
    total, parts = loss(net(torch.rand(1, 3, 40, 64), torch.from_numpy(intrinsics(200, (40, 64))).float()[None]), batch)
    total.backward()
    assert torch.isfinite(total) and all(torch.isfinite(value) for value in parts.values())
    assert all(torch.isfinite(p.grad).all() for p in net.parameters() if p.grad is not None)


def test_who_may_take_part() -> None:
    assert training_views(30, range(30), "9::10") == [i for i in range(30) if i not in (9, 19, 29)]
    assert training_views(30, range(5, 17), "9::10") == [i for i in range(5, 17) if i != 14]  # counted from 5
    assert training_views(4, range(4), "none") == [0, 1, 2, 3]
    assert training_views(4, range(4), "2") == [0, 1, 3]
    assert pick_evenly(range(7), 4) == [0, 2, 4, 6] and pick_evenly(range(3), 9) == [0, 1, 2]
    for wrong in ("x", "1:2:0", "::", "9-10"):
        with pytest.raises(DataError, match="hold-out"):
            training_views(5, range(5), wrong)


def test_adapting_learns_the_scene(net: bts.Bts) -> None:
    """On a scene unlike what it knows, the error of a view it did not see falls to a fraction."""
    views = [road(seed=n) for n in range(3)]
    before = {name: value.clone() for name, value in net.state_dict().items()}
    adapted = fine_tune(net, DepthSupervision(views), AdaptConfig(steps=25, lr=4e-3, ema=0.8), bf16=False)

    def error(model: Any) -> float:
        other = road(seed=9)
        known = other.depth_m > 0
        found = run(model, other.image, other.camera.K).depth_m[0].numpy()
        return float(np.mean(np.abs(np.log(found[known] / other.depth_m[known]))))

    assert error(adapted) < 0.4 * error(net)
    assert all(torch.equal(before[name], value) for name, value in net.state_dict().items())  # the given one stays


def make(drive: Road, method: Mono, folder: Path, notes: list[str] | None = None) -> build.BuildReport:
    return build.prepare(drive, method, folder=folder).run(on_note=(notes if notes is not None else []).append)


def test_a_drive_is_built(file: Path, tmp_path: Path) -> None:
    report = make(Road(3), Mono(weights=file, size="s"), tmp_path)
    assert not report.failed and len(report.built) == 3
    depth = report.prior.read("000001")
    assert depth.depth_m.shape == (64, 160)
    assert depth.confidence is not None and depth.confidence.min() >= 0 and depth.confidence.max() <= 1
    assert np.all((depth.confidence > 0) <= depth.valid)


def test_the_key_holds_what_decides(file: Path, tmp_path: Path) -> None:
    def key(**fields: Any) -> str:
        return build.prepare(Road(3), Mono(weights=file, size="s", **fields), folder=tmp_path).prior.name

    plain = key()
    assert key(adapt_s=9.0, hold_out="::2", frames="0:2", align_to="sparse") == plain  # nothing is adapted or aligned
    others = [key(align="scale"), key(align="scale", hold_out="::2"), key(align="scale", align_in="disparity")]
    assert len({plain, *others}) == 4


def test_no_weights_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(weights, "FOLDER", tmp_path / "none")
    with pytest.raises(DataError, match="no weights for bts") as caught:
        make(Road(3), Mono(), tmp_path)
    assert "\n" not in str(caught.value) and "train" in str(caught.value)


@pytest.mark.parametrize("kind", ["scale", "scale-shift"])
@pytest.mark.parametrize("space", ["depth", "disparity"])
def test_held_out_frames_are_not_read(file: Path, tmp_path: Path, kind: Any, space: Any) -> None:
    """A drive's alignment never reads a frame that is held out (Road fails when one is read)."""
    drive = Road(12, closed=(1, 4, 7, 10))
    method = Mono(weights=file, size="s", align=kind, align_to="sparse", align_in=space, hold_out="1::3")
    method.resolve(drive[0]).prepare(drive, tmp_path)
    assert set(drive.read) <= {0, 2, 3, 5, 6, 8, 9, 11} and len(set(drive.read)) >= 4


def test_adapting_reads_no_held_out_frame_and_is_kept(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(READS, "lidar", ("sparse",))
    known = "priors.methods._reference.ReferenceDepth.__call__"
    monkeypatch.setattr(known, lambda self, frame: frame.sparse().depth_m)
    drive, notes = Road(12, closed=(9,)), []
    method = Mono(weights=file, size="s", adapt="lidar", adapt_s=0.5, runtime="fp32").resolve(drive[0])
    first = method.prepare(drive, tmp_path / "weights", notes.append)(drive[3])
    assert 9 not in drive.read and len(set(drive.read)) == 11
    assert any("adapting" in note for note in notes)
    drive.read.clear()
    notes.clear()
    again = method.prepare(drive, tmp_path / "weights", notes.append)(drive[3])
    assert set(drive.read) <= {0, 3} and len(notes) == 1 and "before" in notes[0]
    np.testing.assert_array_equal(first.depth_m, again.depth_m)
    with pytest.raises(DataError, match="prepare"):
        method(drive[3])
    (weights,) = (tmp_path / "weights").iterdir()
    weights.rename(tmp_path / "not yet")
    held = claim.take(weights.with_suffix(".claim"))
    assert held is not None

    def finish() -> None:
        (tmp_path / "not yet").rename(weights)
        held.release()

    threading.Timer(0.1, finish).start()
    notes.clear()
    method.prepare(drive, weights.parent, notes.append)
    assert "waiting" in notes[0] and "before" in notes[1], "another build's are taken"
    assert list(weights.parent.iterdir()) == [weights]


def test_what_a_drive_lacks_is_said(file: Path, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no LiDAR"):
        make(Road(3), Mono(weights=file, size="s", adapt="lidar"), tmp_path)
    with pytest.raises(DataError, match="no LiDAR"):
        make(Road(3), Mono(weights=file, size="s", align="scale", align_to="lidar"), tmp_path)
