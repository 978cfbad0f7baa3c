"""Adapting to posed frames: looking up, photometric error, neighbours, and what must not be read."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from guarded import GuardedDrive
from hypothesis import given, settings
from hypothesis import strategies as st

from priors import geometry
from priors.adapt.depth_hints import STEP, find_hints
from priors.adapt.photometric import dissimilarity, look_up, mismatch, photometric
from priors.adapt.posed_views import FARTHEST_M, NEAREST_M, PosedView, SourceView, neighbours, pair_up, posed_batch
from priors.adapt.video_supervision import VideoSupervision
from priors.adapt.views import SKY, SURFACE, LabelledView
from priors.errors import DataError
from priors.methods.mono import Mono
from priors.nets import bts, weights
from priors.nets.bts import MonoOut
from priors.types import Camera, Frame, Matrix

SIZE = (64, 160)
CAMERA = Camera(np.array([[120.0, 0, 78.0], [0, 125.0, 20.0], [0, 0, 1.0]]), SIZE)
NORMAL, OFFSET_M = np.array([0.15, 0.8, 0.4]), 3.2
"""The world is one slanted plane NORMAL . x = OFFSET_M."""


def pose(z_m: float, x_m: float = 0.0, turned: float = 0.0) -> Matrix:
    """T_world_cam of a camera that has gone forward and right, and turned right (radians)."""
    T = np.eye(4)
    T[:3, :3] = [[np.cos(turned), 0, np.sin(turned)], [0, 1, 0], [-np.sin(turned), 0, np.cos(turned)]]
    T[:3, 3] = x_m, 0, z_m
    return T


def picture(T_world_cam: Matrix) -> tuple[np.ndarray, np.ndarray]:
    """Render the plane, exactly: image and depth."""
    rays = geometry.rays(CAMERA) @ T_world_cam[:3, :3].T
    depth_m = (OFFSET_M - NORMAL @ T_world_cam[:3, 3]) / (rays @ NORMAL)
    at = T_world_cam[:3, 3] + rays * depth_m[..., None]
    waves = [np.sin(2.1 * at[..., 0] + 1.3 * at[..., 2] + n) + np.sin(2.9 * at[..., 2] - at[..., 0]) for n in range(3)]
    return np.rint(127 + 55 * np.stack(waves, axis=-1)).astype(np.uint8), depth_m.astype(np.float32)


def clip(*sources: Matrix, factor: float = 1.0, sky: np.ndarray | None = None) -> PosedView:
    """The plane seen from the origin, with a depth that is wrong by a factor, and from elsewhere."""
    image, depth_m = picture(np.eye(4))
    labels = np.full(SIZE, SURFACE, np.int8) if sky is None else np.where(sky, SKY, SURFACE).astype(np.int8)
    view = LabelledView(image, CAMERA, depth_m * np.float32(factor), labels, "plane")
    near = [SourceView(picture(T)[0], CAMERA, geometry.invert(T)) for T in sources]
    return PosedView(view, np.zeros(SIZE, np.float32), (near[0], near[-1]))


def bilinear(image: np.ndarray, u: float, v: float) -> np.ndarray:
    x, y = int(np.floor(u)), int(np.floor(v))
    a, b = u - x, v - y
    top = (1 - a) * image[y, x] + a * image[y, x + 1]
    return (1 - b) * top + b * ((1 - a) * image[y + 1, x] + a * image[y + 1, x + 1])


def test_looking_up_by_hand() -> None:
    """Pixel by pixel: into space, into the neighbour's frame, onto its image, between its pixels."""
    T_world_source = pose(0.6, 0.4, 0.05)
    one = clip(T_world_source)
    rng = np.random.default_rng(next(seed for seed in range(20) if not _mirrors(seed)))
    batch = posed_batch([one], rng, SIZE, (1.0, 1.0), 1)
    found, inside = look_up(batch["sources"][:, 0], batch["turn"][:, 0], batch["shift"][:, 0], batch["depth_m"], 1)
    rays, source, checked = geometry.rays(CAMERA), picture(T_world_source)[0] / 255.0, 0
    for row in range(0, SIZE[0], 5):
        for column in range(0, SIZE[1], 7):
            point = rays[row, column] * one.view.depth_m[row, column]
            moved = geometry.transform(one.sources[0].T_source_target, point[None])
            (u, v), z = (value[0] for value in geometry.project(CAMERA, moved))
            clearly_in = z > 0.2 and 0 < u < SIZE[1] - 1.01 and 0 < v < SIZE[0] - 1.01
            if clearly_in:
                expected = bilinear(source, u, v)
                np.testing.assert_allclose(found[0, :, row, column].numpy(), expected, atol=2e-3)
                checked += 1
            elif not (-0.6 < u < SIZE[1] - 0.4 and -0.6 < v < SIZE[0] - 0.4):
                assert not inside[0, row, column]
            assert inside[0, row, column] or not clearly_in
    assert checked > 150


def _mirrors(seed: int) -> bool:
    """Tell whether the first window drawn from a seed is mirrored."""
    batch = posed_batch([clip(pose(0.5))], np.random.default_rng(seed), SIZE, (1.0, 1.0), 1)
    return float(batch["K"][0, 0, 2]) != CAMERA.K[0, 2]


@pytest.mark.slow
@given(seed=st.integers(0, 10**6), zoom=st.floats(1.0, 1.6), ahead=st.floats(-0.9, 0.9), turned=st.floats(-0.1, 0.1))
@settings(max_examples=15, deadline=None)
def test_true_depth_explains_the_neighbours(seed: int, zoom: float, ahead: float, turned: float) -> None:
    """In any window, mirrored or not, at any scale: true depth explains what is seen, wrong depth does not."""
    one = clip(pose(ahead, 0.5, turned), pose(-ahead, 0.4, -turned))
    batch = posed_batch([one], np.random.default_rng(seed), (64, 96), (zoom, zoom), 1)
    everywhere = torch.ones(1, 64, 96, dtype=torch.bool)

    def error(factor: float, stride: int) -> float:
        return float(photometric(1 / (factor * batch["depth_m"]), everywhere, batch, stride, 1))

    for stride, largest, times in ((1, 0.01, 3), (2, 0.03, 1.5)):  # halved, a zoomed texture is not looked up exactly
        assert error(1.0, stride) < largest
        assert min(error(0.7, stride), error(1.4, stride)) > times * error(1.0, stride)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.75, 1.35])
def test_the_loss_pulls_depth_to_metres(factor: float) -> None:
    """A depth that is wrong by a factor, free to scale and tilt, becomes the true one: the poses are in metres."""
    video = VideoSupervision([clip(pose(0.5, 0.3), pose(-0.5, 0.1), factor=factor)])
    rng = np.random.default_rng(0)
    change = torch.zeros(3, requires_grad=True)
    optimiser = torch.optim.Adam([change], lr=0.03)
    errors = []
    for _ in range(40):
        batch = video.batch(rng, 1)
        rows, columns = torch.linspace(-1, 1, SIZE[0])[:, None], torch.linspace(-1, 1, SIZE[1])
        tilted = change[0] + 0.2 * change[1] * rows + 0.2 * change[2] * columns
        total, _ = video.loss(out_of(batch["depth_m"] * tilted.exp()), batch)
        optimiser.zero_grad()
        total.backward()
        optimiser.step()
        errors.append(float(change[0].detach()) + np.log(factor))
    assert np.mean(np.abs(errors[-5:])) < 0.04 < abs(errors[0])


@pytest.mark.parametrize("factor", [0.4, 1.0, 2.5])
def test_hints_lead_back_from_afar(factor: float) -> None:
    """Where the error's slope is no guide, the factor that explains the neighbours is found, or nothing is said."""
    one = clip(pose(0.4, 0.5), pose(-0.3, -0.5), factor=factor)
    batch = posed_batch([one], np.random.default_rng(0), SIZE, (1.0, 1.0), 1)
    upper = torch.arange(SIZE[0])[None, :, None].expand(1, *SIZE) < 24
    found = find_hints(1 / batch["depth_m"], ~upper, batch, 2, 1)
    assert not found.certain[:, :12].any() and found.certain[:, 12:].float().mean() > 0.4
    off = (found.change + np.log(factor))[found.certain].abs()
    assert float((off < STEP).float().mean()) > 0.97
    share = float(found.elsewhere.float().mean())
    assert share < 0.02 if factor == 1.0 else share > 0.3
    assert float(found.error()) == pytest.approx(abs(np.log(factor)), abs=STEP)


def out_of(depth_m: torch.Tensor) -> MonoOut:
    zeros = torch.zeros_like(depth_m)
    return MonoOut(depth_m, zeros, zeros, zeros)


def test_what_moves_along_and_the_sky_teach_nothing() -> None:
    still = clip(pose(0.5))
    still = PosedView(
        still.view, still.log_scale, (SourceView(still.view.image, CAMERA, geometry.invert(pose(0.5))),) * 2
    )
    upper = np.arange(SIZE[0])[:, None].repeat(SIZE[1], 1) < 32
    below = np.arange(SIZE[0])[:, None].repeat(SIZE[1], 1) >= 31  # a window of 3x3 around the first row of surface
    for one, taught in ((still, np.zeros(SIZE, bool)), (clip(pose(0.5, 0.3), factor=1.2, sky=upper), below)):
        batch = posed_batch([one], np.random.default_rng(0), SIZE, (1.0, 1.0), 1)
        inverse = (1 / batch["depth_m"]).requires_grad_(True)
        photometric(inverse, batch["sky"] == SURFACE, batch, 1, 1).backward()
        assert inverse.grad is not None
        assert not np.any(inverse.grad[0].numpy()[~taught]) and np.any(inverse.grad[0].numpy()) == taught.any()


def test_dissimilarity_by_hand() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.random((5, 6)), rng.random((5, 6))
    found = dissimilarity(*(torch.from_numpy(v)[None, None] for v in (a, b)))[0, 0].numpy()
    x, y = a[1:4, 2:5], b[1:4, 2:5]
    together = np.mean(x * y) - x.mean() * y.mean()
    ssim = (2 * x.mean() * y.mean() + 1e-4) * (2 * together + 9e-4)
    ssim /= (x.mean() ** 2 + y.mean() ** 2 + 1e-4) * (x.var() + y.var() + 9e-4)
    assert found[2, 3] == pytest.approx((1 - ssim) / 2, rel=1e-6)
    images = torch.rand(1, 3, 4, 5), torch.rand(1, 3, 4, 5)
    nowhere = torch.zeros(1, 4, 5, dtype=torch.bool)
    assert float(mismatch(images[0], images[0], ~nowhere).max()) < 1e-6 < 1 < float(mismatch(*images, nowhere).min())


@given(st.lists(st.floats(0, 2.5), min_size=3, max_size=40), st.sets(st.integers(0, 39)))
@settings(max_examples=50, deadline=None)
def test_neighbours_lie_near_and_took_part(steps_m: list[float], closed: set[int]) -> None:
    places_m = np.cumsum(steps_m)
    poses = {index: pose(z_m) for index, z_m in enumerate(places_m) if index not in closed}
    for index in poses:
        near = neighbours(poses, index)
        gaps_m = {other: abs(places_m[other] - places_m[index]) for other in poses}
        if near is None:
            assert not any(NEAREST_M < gap_m < FARTHEST_M for gap_m in gaps_m.values())
            continue
        assert all(other in poses and NEAREST_M <= gaps_m[other] <= FARTHEST_M for other in near)
        assert near[0] == near[1] or near[0] < index < near[1]


@dataclass
class Trip(GuardedDrive):
    """A drive over the plane, a pose and an image every `step_m`."""

    posed: bool = True
    step_m: float = 0.4

    def __getitem__(self, index: int) -> Frame:
        image = self.reader(index, lambda: picture(pose(self.step_m * (index % 6)))[0])
        T_world_cam = pose(self.step_m * index)
        return Frame(self.ids[index], CAMERA, {"image": image}, {}, T_world_cam if self.posed else None)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    path = tmp_path / "mine.safetensors"
    weights.write(path, bts.Bts("s"), {"net": "bts", "size": "s"})
    return path


def prepare(drive: Trip, file: Path, notes: list[str]) -> Callable[[Frame], Any]:
    method = Mono(weights=file, size="s", adapt="video", adapt_s=0.3, runtime="fp32").resolve(drive[0])
    return method.prepare(drive, file.parent / "weights", notes.append)


def test_held_out_frames_are_neither_targets_nor_neighbours(file: Path) -> None:
    drive, notes = Trip(14, closed=(9,)), []
    first = prepare(drive, file, notes)(drive[3])
    assert set(drive.read) == set(range(14)) - {9}
    assert "posed neighbours" in notes[0] and any("photometric error" in note for note in notes)
    drive.read.clear()
    notes.clear()
    again = prepare(drive, file, notes)(drive[3])
    assert set(drive.read) == {3} and len(notes) == 1 and "before" in notes[0]
    np.testing.assert_array_equal(first.depth_m, again.depth_m)
    prepare(Trip(14, closed=(9,), step_m=0.5), file, notes)  # other poses, other weights
    assert len(list((file.parent / "weights").iterdir())) == 2


def test_long_drives_are_thinned_but_not_their_neighbours() -> None:
    pairs = pair_up(Trip(200), range(200), 10)
    assert len(pairs) == 10 and all(abs(other - index) <= 3 for index, near in pairs.items() for other in near)


@pytest.mark.parametrize(
    ("drive", "says"),
    [(Trip(posed=False), "poses.txt.*choose"), (Trip(step_m=50.0), "m apart"), (Trip(step_m=0.0), "m apart")],
)
def test_drives_that_cannot_teach_are_one_line(drive: Trip, says: str, file: Path) -> None:
    with pytest.raises(DataError, match=says) as caught:
        prepare(drive, file, [])
    assert "\n" not in str(caught.value) and not drive.read
