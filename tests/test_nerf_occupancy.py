"""Occupancy: carving against a plain loop and against what each rule promises; pruning, determinism, state."""

import dataclasses

import numpy as np
import pytest
import torch

from nerf.kernels import cpu_kernels
from nerf.occupancy import AGREED, WARM_UP, Occupancy
from nerf.sample import Sampler
from nerf.scene import Scene, view_rays
from nerf.space import Kind, Space
from nerf.twin import occupancy as twin
from nerf.twin.space import stretch
from nerf.types import Rays
from priors.geometry import rays as pixel_rays
from priors.types import Camera

KINDS: list[Kind] = ["box", "ball", "spheres", "cube"]
HEIGHT, WIDTH, FRAMES = 24, 48, 6
CAMERA = Camera(np.array([[40.0, 0, 23.5], [0, 40.0, 8.0], [0, 0, 1]]), (HEIGHT, WIDTH))
REACH = 0.1
FOG = 0.02
"""Density of a field that has learned nothing yet, 1/m: nerf.mlp."""


def wall_depth(position: int) -> np.ndarray:
    """A wall 30 m ahead of the first camera and a road 1.6 m below, camera moving 1 m a frame; exact camera-z depth."""
    y = pixel_rays(CAMERA)[..., 1]
    road = np.where(y > 0, 1.6 / np.maximum(y, 1e-9), np.inf)
    return np.minimum(road, 30.0 - position).astype(np.float32)


def scene(depth_m: np.ndarray | None) -> Scene:
    poses = np.tile(np.eye(4), (FRAMES, 1, 1))
    poses[:, 2, 3] = np.arange(FRAMES)
    images = np.zeros((FRAMES, HEIGHT, WIDTH, 3), np.uint8)
    ids = [str(i) for i in range(FRAMES)]
    return Scene("wall", ids, CAMERA, poses, images, depth_m, None, [0, 1, 2, 4, 5], [3])


def space(kind: Kind, air_m: float = 0.0) -> Space:
    return Space(kind, (0.0, 0.0, 15.0), (20.0, 12.0, 20.0), 0.5, 100.0, air_m=air_m)


DENSE = np.stack([wall_depth(i) for i in range(FRAMES)])


def lower_half(depth_m: np.ndarray) -> np.ndarray:
    """A scanner's map: every other column and row, nothing in the upper 12 rows."""
    sparse = np.zeros_like(depth_m)
    sparse[:, 12::2, ::2] = depth_m[:, 12::2, ::2]
    return sparse


def size(made: Space, place: np.ndarray) -> float:
    """How far out a place lies, by its space's norm."""
    return float(np.abs(place).max() if made.kind == "cube" else np.linalg.norm(place))


def cell(made: Space, place: np.ndarray, resolution: int) -> tuple[int, ...]:
    """Table, z, y, x of a place, from the spaces' formulas."""
    radius = size(made, place)
    inner = made.kind == "box" or (made.kind == "spheres" and radius <= 1)
    u = (place + 1) / 2 if inner else (2 - 1 / max(radius, 1)) * place / max(radius, 1) / 4 + 0.5
    x, y, z = np.clip((u * resolution).astype(int), 0, resolution - 1)
    return int(made.kind == "spheres" and radius > 1), z, y, x


def naive(made: Space, drive: Scene, resolution: int) -> np.ndarray:
    """Rules 1 and 3 for a dense prior, one ray and one step after the other, float64."""
    votes = np.zeros((2, made.tables, *[resolution] * 3), int)
    side = (2 if made.kind == "box" else 4) / resolution
    for position in drive.train:
        marks = np.zeros(votes.shape, bool)
        pose = drive.T_world_cam[position]
        origin = (pose[:3, 3] - made.centre_m) / made.half_m
        for (row, column), depth_m in np.ndenumerate(drive.depth_m[position]):
            direction = pose[:3, :3] @ pixel_rays(drive.camera)[row, column] / made.half_m
            for mark, begin, end in ((0, 1 - REACH, 1 + REACH), (1, 0, 1 - REACH)):
                t, last = (np.clip(depth_m * x, made.near_m, made.far_m) for x in (begin, end))
                while True:
                    place = origin + t * direction
                    marks[(mark, *cell(made, place, resolution))] = True
                    radius = size(made, place)
                    outer = max(radius, 1)
                    stretch = {"box": 1.0, "ball": outer, "cube": outer, "spheres": radius if radius >= 1 else 0.5}
                    if t >= last:
                        break
                    t = min(last, t + 0.5 * side * stretch[made.kind] / np.linalg.norm(direction))
        votes += marks
    agreed = (votes[0] > 0) & (votes[0] >= AGREED * votes.sum(axis=0))
    grown = np.zeros_like(agreed)
    for table, z, y, x in np.argwhere(agreed):
        near = (slice(max(0, i - 1), i + 2) for i in (z, y, x))
        grown[(table, *near)] = True
    return grown


def surface(drive: Scene, position: int, share: float = 1.0) -> torch.Tensor:
    rays = view_rays(drive.camera, drive.T_world_cam[position])
    depth_m = torch.from_numpy(wall_depth(position).reshape(-1))
    return rays.origins_m + share * depth_m[:, None] * rays.directions


@pytest.mark.parametrize("kind", KINDS)
def test_a_dense_prior_keeps_the_surfaces_and_empties_the_air(kind: Kind) -> None:
    carved = Occupancy.carve(space(kind), scene(DENSE), 64, REACH)
    held_out = surface(scene(DENSE), 3)
    assert carved.holds(held_out).float().mean() > 0.99
    above = torch.arange(HEIGHT * WIDTH) < 8 * WIDTH
    assert carved.holds(surface(scene(DENSE), 3, 0.5)[above]).float().mean() < 0.01
    assert carved.share < 0.2


@pytest.mark.parametrize("kind", KINDS)
def test_a_scanner_cuts_nothing_away_above_it(kind: Kind) -> None:
    carved = Occupancy.carve(space(kind), scene(lower_half(DENSE)), 64, REACH)
    drive = scene(DENSE)
    assert carved.holds(surface(drive, 3)).float().mean() > 0.99
    # Upper rows, far above every ray with a value: any depth.
    top = view_rays(CAMERA, drive.T_world_cam[3])
    for t in (4.0, 12.0, 25.0, 60.0):
        points = (top.origins_m + t * top.directions)[: 6 * WIDTH]
        assert carved.holds(points).float().mean() > 0.97
    # But the air above the road, through which its rays look, is empty.
    below = torch.from_numpy((wall_depth(3) > 15) & (np.arange(HEIGHT)[:, None] >= 12)).reshape(-1)
    dense = Occupancy.carve(space(kind), drive, 64, REACH)
    air = surface(drive, 3, 0.6)[below]
    assert carved.holds(air).float().mean() < dense.holds(air).float().mean() + 0.1


@pytest.mark.parametrize("kind", KINDS)
def test_without_a_prior_what_the_cameras_see_is_open(kind: Kind) -> None:
    carved = Occupancy.carve(space(kind), scene(None), 64)
    for share in (0.3, 1.0, 2.0):
        assert carved.holds(surface(scene(None), 3, share)).float().mean() > 0.99
    assert not carved.holds(torch.tensor([[0.0, 0.0, -8.0], [0.0, 11.0, 0.0]])).any()


def test_a_map_without_any_value_is_as_good_as_no_prior() -> None:
    blank = Occupancy.carve(space("ball"), scene(np.zeros_like(DENSE)), 32)
    assert torch.equal(blank.kept, Occupancy.carve(space("ball"), scene(None), 32).kept)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1.0])
def test_values_that_are_no_depth_count_as_none(bad: float) -> None:
    holes, spoilt = DENSE.copy(), DENSE.copy()
    holes[:, :10, :20], spoilt[:, :10, :20] = 0, bad
    one, other = (Occupancy.carve(space("ball"), scene(depth_m), 32) for depth_m in (holes, spoilt))
    assert torch.equal(one.kept, other.kept)


def test_one_views_outliers_are_voted_down() -> None:
    # 5 training views are too few for a tenth: 18 are not.
    drive = scene(None)
    count = 24
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 2, 3] = np.arange(count) * 0.2
    depth_m = np.full((count, HEIGHT, WIDTH), 25.0, np.float32) - poses[:, 2, 3, None, None].astype(np.float32)
    spoilt = depth_m.copy()
    spoilt[10, 8:12, 20:28] = 12.0
    many = [
        dataclasses.replace(drive, T_world_cam=poses, depth_m=d, train=list(range(count))) for d in (depth_m, spoilt)
    ]
    clean, voted = (Occupancy.carve(space("ball"), one, 48) for one in many)
    assert torch.equal(clean.kept, voted.kept)


def test_carving_is_the_same_every_time() -> None:
    one, other = (Occupancy.carve(space("spheres"), scene(lower_half(DENSE)), 48) for _ in range(2))
    assert torch.equal(one.kept, other.kept) and torch.equal(one.allowed, other.allowed)


def thick_wall(made: Space):
    """A field that is opaque within 2 m of z = 30 m, and thin elsewhere."""

    def density(u: torch.Tensor, table: torch.Tensor) -> torch.Tensor:
        z = made.unwarp(u, table)[:, 2]
        return torch.where((z - 30).abs() < 2, 20.0, 1e-5)

    return density


@pytest.mark.parametrize("kind", KINDS)
def test_pruning_leaves_what_the_field_says(kind: Kind) -> None:
    made = space(kind)
    grid = Occupancy.carve(made, scene(None), 24)
    before = grid.share
    for step in range(0, WARM_UP, 16):
        grid.update(thick_wall(made), (0, step), 4096)
        assert grid.share == before
    for step in range(WARM_UP, WARM_UP + 1600, 16):
        grid.update(thick_wall(made), (0, step), 4096)
    assert grid.share < 0.7 * before
    drive = scene(None)
    rays = view_rays(CAMERA, drive.T_world_cam[3])
    wall = rays.origins_m + 27.0 * rays.directions
    # The contraction's cells are coarse there: their middles may all lie within the wall.
    u, _ = made.warp(wall)
    inside = (u > 0.02).all(dim=1) & (u < 0.98).all(dim=1)
    assert grid.holds(wall[inside]).float().mean() > 0.97
    assert grid.holds(rays.origins_m + 12.0 * rays.directions).float().mean() < 0.05


@pytest.mark.parametrize("kind", ["cube", "spheres"])
def test_how_fine_a_grid_is_does_not_say_what_is_empty(kind: Kind) -> None:
    """Fog near the cameras stays in cells of any size that are smaller than the air that is asked about."""
    made = space(kind, air_m=3.0)
    rays = view_rays(CAMERA, scene(None).T_world_cam[3])
    near = rays.origins_m + 3.0 * rays.directions

    def density(u: torch.Tensor, table: torch.Tensor) -> torch.Tensor:
        return torch.where(made.unwarp(u, table)[:, 2] < 25, FOG, 5.0)

    for resolution in (16, 48):
        grids = [Occupancy(dataclasses.replace(made, air_m=air_m), resolution) for air_m in (3.0, 0.0)]
        for grid in grids:
            for step in range(WARM_UP, WARM_UP + 320, 16):
                grid.update(density, (0, step))
        assert grids[0].holds(near).all()
    assert grids[1].holds(near).float().mean() < 0.5, "small cells are thin"


def test_a_pruned_cell_comes_back_when_something_grows_there() -> None:
    made = space("ball")
    grid = Occupancy(made, 8)
    thin = lambda u, table: torch.full((len(u),), 1e-6)  # noqa: E731
    thick = lambda u, table: torch.full((len(u),), 5.0)  # noqa: E731
    some = lambda u, table: torch.where(u[:, 0] > 0.5, 5.0, 1e-6)  # noqa: E731
    for step in range(WARM_UP, WARM_UP + 10):
        grid.update(some, (1, step), 4096)
    assert 0.4 < grid.share < 0.6
    for step in range(WARM_UP + 10, WARM_UP + 20):
        grid.update(thick, (1, step), 4096)
    assert grid.share == 1
    for step in range(WARM_UP + 20, WARM_UP + 40):
        grid.update(thin, (1, step), 4096)
    assert grid.share > 0.9  # everything is equally thin: nothing to choose from


def test_what_is_carved_away_stays_away_and_the_rest_is_pruned() -> None:
    made = space("ball")
    grid = Occupancy.carve(made, scene(lower_half(DENSE)), 24)
    carved = grid.kept.clone()
    for step in range(WARM_UP, WARM_UP + 800, 16):
        grid.update(thick_wall(made), (0, step), 2048)
    assert (grid.kept <= carved).all()
    assert 0.01 < grid.share < 0.8 * carved.float().mean()


def test_training_samples_are_noted() -> None:
    made = space("ball")
    grid = Occupancy(made, 16)
    rays = Rays(torch.zeros(64, 3), torch.tensor([[0.0, 0.0, 1.0]]).repeat(64, 1))
    found = Sampler(made, grid).march(rays, 64, (0, 0))
    sigma = torch.where((found.t - 20).abs() < 1, 3.0, 1e-6)
    for _ in range(3):
        grid.observe(found, sigma)
    known = grid.thickness >= 0
    assert 5 < known.sum() < 64
    assert (grid.thickness[known] > 1).sum() in range(1, 4)


def test_state_goes_on_bit_for_bit() -> None:
    made = space("spheres")
    one = Occupancy.carve(made, scene(None), 16)
    one.update(thick_wall(made), (2, WARM_UP), 512)
    other = Occupancy(made, 16)
    other.load({name: tensor.clone() for name, tensor in one.state().items()})
    for grid in (one, other):
        grid.update(thick_wall(made), (2, WARM_UP + 16), 512)
    for name, tensor in one.state().items():
        assert torch.equal(tensor, other.state()[name])
    with pytest.raises(ValueError, match="expected"):
        Occupancy(made, 8).load(one.state())


def test_untrusted_values_carve_nothing() -> None:
    # A guess near the cameras in the upper rows at a tenth of confidence, the truth below them.
    guess = DENSE.copy()
    guess[:, :12] = 3.0
    weight = np.full(guess.shape, 255, np.uint8)
    weight[:, :12] = 25
    absent = guess.copy()
    absent[:, :12] = 0
    made = space("ball")
    trusting, wary = (
        Occupancy.carve(made, dataclasses.replace(scene(guess), weight=weight), 32, trust=x) for x in (0.0, 0.2)
    )
    assert torch.equal(wary.kept, Occupancy.carve(made, scene(absent), 32).kept)
    assert not torch.equal(wary.kept, trusting.kept)


def looked_at(kind: Kind, count: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Places in two tables, many of them in the same few cells, and densities."""
    g = torch.Generator().manual_seed(seed)
    u = torch.rand(count, 3, generator=g)
    u[::2] = 0.4 + 0.05 * u[::2]
    u[:3] = torch.tensor([[0.0, 0, 0], [1, 1, 1], [0.5, 0.5, 0.5]])
    table = torch.randint(space(kind).tables, (count,), generator=g, dtype=torch.int32)
    return u, table, torch.exp(6 * torch.rand(count, generator=g) - 4)


@pytest.mark.parametrize("air_m", [0.0, 3.0])
@pytest.mark.parametrize("kind", KINDS)
def test_upkeep_by_kernels_equals_the_twin_bit_for_bit(kind: Kind, air_m: float) -> None:
    made, fast = space(kind, air_m), cpu_kernels().sample
    thickness = [torch.full((made.tables, 16, 16, 16), -1.0) for _ in range(2)]
    allowed = (torch.rand(thickness[0].shape) > 0.3).to(torch.uint8)
    kept = [torch.zeros_like(allowed) for _ in range(2)]
    for seed in range(3):
        seen = looked_at(kind, 2000, seed)
        assert torch.equal(fast.stretch(*seen[:2], made.extent), stretch(*seen[:2], made.extent))
        fast.note(thickness[0], *seen, made.extent, 0.7)
        twin.note(thickness[1], *seen, made.extent, 0.7)
        assert torch.equal(*thickness)
    half = float(thickness[0][thickness[0] >= 0].median())
    for thin in (half, 1e6):  # the mean is the limit where it is less
        fast.prune(thickness[0], allowed, thin, kept[0])
        twin.prune(thickness[1], allowed, thin, kept[1])
        assert torch.equal(*kept)
        assert 0 < kept[0].sum() < allowed.sum()


def test_cells_that_nobody_looked_at_stay() -> None:
    thickness = torch.full((1, 8, 8, 8), -1.0)
    allowed, kept = torch.ones(thickness.shape, dtype=torch.uint8), torch.zeros(thickness.shape, dtype=torch.uint8)
    cpu_kernels().sample.prune(thickness, allowed, 0.03, kept)
    assert kept.all()


@pytest.mark.parametrize("resolution", [5, 16, 72])
def test_few_cells_that_were_looked_at_are_found_among_the_others(resolution: int) -> None:
    fast, g = cpu_kernels().sample, torch.Generator().manual_seed(resolution)
    thickness = torch.full((2, resolution, resolution, resolution), -1.0)
    allowed = (torch.rand(thickness.shape, generator=g) > 0.3).to(torch.uint8)
    allowed.view(-1)[-1] = 1
    flat = thickness.view(-1)
    flat[torch.randint(len(flat), (9,), generator=g)] = torch.rand(9, generator=g)
    flat[-1] = 0.0  # a loop's last cell
    kept = [torch.zeros_like(allowed) for _ in range(2)]
    fast.prune(thickness, allowed, 0.5, kept[0])
    twin.prune(thickness, allowed, 0.5, kept[1])
    assert torch.equal(*kept)
    assert kept[0].view(-1)[-1] == 0 < kept[0].sum()
