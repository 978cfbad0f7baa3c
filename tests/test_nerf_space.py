"""Spaces: the three families' maps against their formulas in float64, their spacing, and how they are chosen."""

import dataclasses
import tracemalloc

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from nerf.space import Kind, Space
from nerf.twin import space as twin
from nerf.types import Rays

KINDS: list[Kind] = ["box", "ball", "spheres", "cube"]
TURNED = ((0.8, 0.6, 0.0), (-0.6, 0.8, 0.0), (0.0, 0.0, 1.0))


def make(kind: Kind, **changes) -> Space:
    return dataclasses.replace(Space(kind, (3.0, -1.0, 20.0), (10.0, 4.0, 30.0), 0.5, 200.0, TURNED), **changes)


def formula(space: Space, point: np.ndarray) -> tuple[np.ndarray, int]:
    """One point's u and table, from the issue's formulas, float64."""
    x = np.array(space.axes) @ (point - np.array(space.centre_m)) / np.array(space.half_m)
    r = np.abs(x).max() if space.kind == "cube" else np.linalg.norm(x)
    if space.kind == "box":
        return np.clip((x + 1) / 2, 0, 1), 0
    z = x if r <= 1 else (2 - 1 / r) * (x / r)
    if space.kind == "spheres" and r <= 1:
        return (x + 1) / 2, 0
    return z / 4 + 0.5, int(space.kind == "spheres")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("size", [0.0, 1e-30, 1e-3, 1.0, 50.0, 1e3, 1e6, 1e12, 1e30])
def test_warp_equals_the_formula_at_every_magnitude(kind: Kind, size: float) -> None:
    space = make(kind)
    directions = np.random.default_rng(1).normal(size=(50, 3))
    points = np.array(space.centre_m) + size * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    points = points.astype(np.float32)
    u, table = space.warp(torch.from_numpy(points))
    assert torch.isfinite(u).all() and u.min() >= 0 and u.max() <= 1
    for i, point in enumerate(points.astype(np.float64)):
        expected, expected_table = formula(space, point)
        np.testing.assert_allclose(u[i], expected, atol=2e-6)
        assert table[i] == expected_table


@pytest.mark.parametrize("kind", KINDS)
def test_warp_of_infinity_is_on_the_border(kind: Kind) -> None:
    u, _ = make(kind).warp(torch.tensor([[torch.inf, 0.0, 0.0], [0.0, -torch.inf, torch.inf], [3e38, 3e38, 3e38]]))
    assert torch.isfinite(u).all() and u.min() >= 0 and u.max() <= 1


@pytest.mark.parametrize("kind", KINDS)
def test_unwarp_undoes_warp(kind: Kind) -> None:
    space = make(kind)
    points = torch.from_numpy(np.random.default_rng(2).normal(size=(500, 3)) * 15 + np.array(space.centre_m))
    u, table = space.warp(points)
    inside = (u > 0).all(dim=1) & (u < 1).all(dim=1)
    assert inside.sum() > 30
    torch.testing.assert_close(space.unwarp(u, table)[inside], points[inside], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("kind", ["ball", "spheres", "cube"])
def test_a_unit_of_u_spans_the_stretch(kind: Kind) -> None:
    space = make(kind, half_m=(12.0, 12.0, 12.0))
    away = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64) * torch.tensor([[3.0], [11.0], [40.0], [150.0]])
    centre = torch.tensor(space.centre_m, dtype=torch.float64)
    u, table = space.warp(centre + away)
    further, _ = space.warp(centre + away * (1 + 1e-6))
    found = (away * 1e-6).norm(dim=1) / (further - u).norm(dim=1)
    torch.testing.assert_close(space.stretch_m(u, table), found, rtol=1e-3, atol=0)


def test_the_outer_table_of_spheres_holds_direction_and_inverse_radius() -> None:
    space = make("spheres")
    x = torch.tensor([[4.0, 0.0, 3.0]]) * torch.tensor(space.half_m) @ torch.tensor(space.axes)
    u, table = space.warp(x + torch.tensor(space.centre_m))
    z = u[0] * 4 - 2
    assert table[0] == 1
    torch.testing.assert_close(z / z.norm(), torch.tensor([0.8, 0.0, 0.6]))
    torch.testing.assert_close(2 - z.norm(), torch.tensor(1 / 5))


@given(
    depth=st.lists(st.floats(0.5, 200, width=32), min_size=2, max_size=20),
    knee=st.floats(0.25, 150, width=32),
)
def test_spacing_rises_and_is_undone(depth: list[float], knee: float) -> None:
    space = make("ball")
    t = torch.tensor(sorted(depth), dtype=torch.float32)
    knees = torch.full_like(t, knee)
    ramps = space.spacing(knees)
    s = twin.spacing(t, ramps)
    assert (s.diff() >= 0).all() and s.min() >= 0 and s.max() <= 1
    # Beyond the knee s is even in 1 / t: what float32 cannot tell there is t^2 / knee eps.
    span = float(ramps.span[0])
    torch.testing.assert_close(twin.depth(s, ramps), t, rtol=1e-5 + 1e-6 * 200 / knee, atol=1e-5 / span)


def test_spacing_covers_near_to_far_linear_then_inverse() -> None:
    space = make("ball", near_m=1.0, far_m=400.0)
    ramps = space.spacing(torch.full((3,), 10.0, dtype=torch.float64))
    ends = twin.spacing(torch.tensor([1.0, 400.0, 1e9], dtype=torch.float64), ramps)
    assert ends.tolist() == [0, 1, 1]
    near = twin.spacing(torch.tensor([2.0, 4.0, 6.0], dtype=torch.float64), ramps).diff()
    torch.testing.assert_close(near[0], near[1])
    far = twin.spacing(1 / torch.tensor([0.05, 0.04, 0.03], dtype=torch.float64), ramps).diff()
    torch.testing.assert_close(far[0], far[1])


def one_ray(origin: list[float], direction: list[float]) -> Rays:
    return Rays(torch.tensor([origin]), torch.tensor([direction]))


def test_rays_are_cut_to_the_box() -> None:
    space = make("box", centre_m=(0.0, 0.0, 10.0), half_m=(5.0, 5.0, 10.0), axes=tuple(map(tuple, np.eye(3))))
    aim = space.aim(one_ray([0, 0, -4], [0.0, 0.0, 1.0]))
    assert (aim.first_m.item(), aim.last_m.item()) == pytest.approx((4, 24))
    aim = space.aim(one_ray([0, 0, 5], [0.5, 0.0, 1.0]))
    assert (aim.first_m.item(), aim.last_m.item()) == pytest.approx((0.5, 10))
    aim = space.aim(one_ray([30, 0, 5], [0.0, 0.0, 1.0]))
    assert aim.last_m.item() <= aim.first_m.item()
    aim = space.aim(one_ray([0, 0, 5], [0.0, 0.0, -1.0]))
    assert (aim.first_m.item(), aim.last_m.item()) == pytest.approx((0.5, 5))


def test_spheres_are_linear_up_to_where_the_ray_leaves_the_inner_one() -> None:
    space = make("spheres", centre_m=(0.0, 0.0, 0.0), half_m=(10.0, 10.0, 10.0))
    assert space.aim(one_ray([0, 0, -5], [0.0, 0.0, 1.0])).spacing.knee_m.item() == pytest.approx(15)
    assert space.aim(one_ray([0, 6, 0], [0.0, 0.0, 1.0])).spacing.knee_m.item() == pytest.approx(8)
    # Parallel to the line from the centre: NeRF++'s rotation formula is 0 / 0 there.
    assert np.isfinite(space.aim(one_ray([0, 0, 5], [0.0, 0.0, 1.0])).spacing.knee_m.item())
    # Outside and past it: no exit, a small knee.
    assert space.aim(one_ray([0, 40, 0], [0.0, 0.0, 1.0])).spacing.knee_m.item() == pytest.approx(5)


@given(
    origin=st.tuples(*[st.floats(-3, 3)] * 3),
    direction=st.tuples(*[st.floats(-1, 1)] * 2),
)
def test_exits_lie_on_the_sphere(origin: tuple[float, ...], direction: tuple[float, ...]) -> None:
    o, d = torch.tensor([origin], dtype=torch.float64), torch.tensor([[*direction, 1.0]], dtype=torch.float64)
    t = twin.exits(o, d)
    if t > 0:
        assert (o + t[:, None] * d).norm().item() == pytest.approx(1, abs=1e-6)
    else:  # nothing in front lies inside
        steps = o + torch.linspace(0.01, 10, 500, dtype=torch.float64)[:, None] * d
        assert steps.norm(dim=1).min() > 1 - 1e-3


def drive(length_m: float, frames: int = 40, turn: float = 0.7) -> np.ndarray:
    """Poses of a camera that looks along its path, level, turned about the world's up axis z, a kilometre away."""
    cosine, sine = np.cos(turn), np.sin(turn)
    ahead, down = np.array([cosine, sine, 0]), np.array([0, 0, -1.0])
    poses = np.tile(np.eye(4), (frames, 1, 1))
    poses[:, :3, :3] = np.stack([np.cross(down, ahead), down, ahead], axis=1)
    poses[:, :3, 3] = 1000 + np.linspace(0, length_m, frames)[:, None] * ahead
    return poses


@pytest.mark.parametrize("kind", KINDS)
def test_a_street_gets_a_long_narrow_low_space_along_its_path(kind: Kind) -> None:
    poses = drive(100)
    space = Space.along(poses, kind)
    axes = np.array(space.axes)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-9)
    along = int(np.argmax(space.half_m))
    assert abs(axes[along] @ poses[0, :3, 2]) > 0.9999 and abs(axes[2, 2]) > 0.9999
    assert max(space.half_m) == pytest.approx(50 + 16)
    assert np.delete(space.half_m, along) == pytest.approx((50 + 16) / 3)
    u, _ = space.warp(torch.from_numpy(poses[:, :3, 3].astype(np.float32)))
    low, high = (0.25, 0.75) if kind in ("ball", "cube") else (0, 1)
    assert u.min() > low and u.max() < high  # the path is in the inner region


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("frames", [1, 2, 40])
@pytest.mark.parametrize("length_m", [0.0, 0.5, 30.0])
def test_a_space_holds_any_path(kind: Kind, frames: int, length_m: float) -> None:
    poses = drive(length_m, frames)
    space = Space.along(poses, kind)
    assert np.isfinite([*space.centre_m, *space.half_m]).all() and min(space.half_m) >= 16
    axes = np.array(space.axes)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-9)
    u, _ = space.warp(torch.from_numpy(poses[:, :3, 3].astype(np.float32)))
    assert u.min() > 0.25 and u.max() < 0.75


def test_a_path_straight_down_and_one_that_turns_back_have_axes() -> None:
    sinking, turning = drive(0), drive(20)
    sinking[:, 2, 3] -= np.linspace(0, 30, 40)
    turning[20:, :3, :2] *= -1  # half of the cameras stand on their heads: their mean down is nothing
    for poses in (sinking, turning):
        axes = np.array(Space.along(poses, "ball").axes)
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-9)


@pytest.mark.parametrize("kind", ["cube", "ball", "spheres"])
def test_cells_and_steps_near_the_camera_do_not_follow_the_path(kind: Kind) -> None:
    for length_m in (30, 100, 300, 1000):
        poses = drive(length_m)
        space = Space.along(poses, kind)
        place = torch.from_numpy(poses[20:21, :3, 3].copy())
        ahead = torch.from_numpy(poses[20:21, :3, 2].copy())
        u, _ = space.warp(place)
        further, _ = space.warp(place + 0.01 * ahead)
        cells = float((further - u).norm()) * 2048 * space.detail / 0.01
        assert cells >= 1 / 0.11, "cells of at most 0.1 m along the path"
        aim = space.aim(Rays(place.float(), ahead.float()))
        ends = twin.depth(torch.linspace(0, 1, 257)[:, None], aim.spacing)
        assert ends.diff(dim=0)[:20].max() < 0.13, "256 steps are dense where the camera sees detail"


def test_a_long_path_takes_memory_by_its_length_not_by_its_square() -> None:
    """A matrix of all frames by all frames is 0.8 GB for 10,000 of them."""
    poses = np.tile(np.eye(4), (4000, 1, 1))
    poses[:, 0, 3] = np.linspace(0, 4000, len(poses))
    tracemalloc.start()
    try:
        Space.along(poses, "box")
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 20 * poses.nbytes
