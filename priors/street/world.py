"""The world: blocks of houses, gardens and parks along a bent street, parked cars, furniture and traffic."""

from dataclasses import replace
from functools import partial

import numpy as np
import numpy.typing as npt

from priors.street import buildings, cars, corner, furniture, ground, mesh, people, plants
from priors.street.config import KERB_HEIGHT_M, KERB_M, StreetConfig
from priors.street.corner import CornerPath
from priors.street.materials import Material
from priors.street.mesh import Finish, Mesh
from priors.street.path import BEHIND_M, Path
from priors.street.raycast import Body

Values = npt.NDArray[np.floating]
PROTOTYPES = 7
GAP_M = 9.0
FINE_LEAVES_M = 16.0
CORNERS_AT_ONCE = 100_000
BESIDE_M = 40.0
"""From a corner's second leg on, houses of the distance stand this far beside the street."""
HILL_TINT = [0.05, 0.07, 0.04]


class World:
    """A still mesh in world coordinates and the cars and people that move through it."""

    def __init__(self, config: StreetConfig) -> None:
        self.config = config
        self.path = CornerPath(config) if config.turn else Path(config)
        rng = np.random.default_rng([config.seed, 4])
        self._trees = [plants.tree(rng) for _ in range(PROTOTYPES)]
        self._far_trees = [plants.tree(rng, 0.2) for _ in range(PROTOTYPES)]
        self._bushes = [plants.bush(rng) for _ in range(4)]
        self._cars = [cars.car(rng) for _ in range(14)]
        parts = [ground.road(config, ends) for ends in corner.road_parts(config, -BEHIND_M, config.length_m + 40)]
        for side in (1, -1):
            parts += self._side(side)
        # What is far from the centre line is not bent: offset curves of that size would fold.
        far = [ground.terrain(config, BEHIND_M), *self._distance()]
        self.still = mesh.merge([self._bend(mesh.merge(parts)), *self._around_the_corner(), *far])
        self.bodies = self._traffic()

    def _bend(self, straight: Mesh) -> Mesh:
        parts = range(0, len(straight), CORNERS_AT_ONCE)
        corners = [self.path.bend(straight.corners[i : i + CORNERS_AT_ONCE]).astype(np.float32) for i in parts]
        heading = self.path.heading_rad(straight.corners[:, 0, 0]).astype(np.float32)[:, None]
        cos, sin = np.cos(heading), np.sin(heading)
        x, y, z = np.moveaxis(straight.normal, -1, 0)
        normal = np.stack([x * cos - y * sin, x * sin + y * cos, z], axis=-1)
        return replace(straight, corners=np.concatenate(corners), normal=normal)

    def _side(self, side: int) -> list[Mesh]:
        """Build one side of the street, block by block; each block has its own seed."""
        parts, number = [], 0
        for stretch in corner.stretches(self.config, side):
            s = stretch.start_m
            while s < stretch.end_m:
                rng = np.random.default_rng([self.config.seed, 5, side + 1, number])
                length = stretch.length_m(s, float(rng.uniform(40, 110)), GAP_M)
                built = bool(rng.random() < self.config.built_share[0 if side > 0 else 1]) and not stretch.is_square
                parts += ground.block_side(self.config, (s, s + length), side, not built, rng.uniform(0, 999))
                parts += self._houses(rng, side, s, s + length) if built else self._park(rng, side, s, s + length)
                parts += self._pavement(rng, side, s, s + length)
                s, number = s + length, number + 1
                if not stretch.is_cut or s < stretch.end_m:
                    parts.append(ground.side_street(self.config, (s, s + GAP_M), side))
                    s += GAP_M
            if stretch.end_m == corner.BEGIN_M:
                parts += self._bent_ground(side)
        return parts

    def _bent_ground(self, side: int) -> list[Mesh]:
        """Make kerb, pavement and lots of one side of a corner; the inner ones end at the middle of its circle."""
        rng = np.random.default_rng([self.config.seed, 11, side + 1])
        lot_m = corner.RADIUS_M - 0.01 if side == self.config.turn else ground.LOT_M
        arc = (corner.BEGIN_M, float(corner.END_M))
        return ground.block_side(self.config, arc, side, side == self.config.turn, rng.uniform(0, 999), lot_m)

    def _around_the_corner(self) -> list[Mesh]:
        """Build houses around a corner's outer side, wall to wall, each turned as the street is before it."""
        if not isinstance(self.path, CornerPath):
            return []
        rng, side = np.random.default_rng([self.config.seed, 12]), -self.config.turn
        front = self.config.front_m(side) + 0.3
        width = 2 * (corner.RADIUS_M + front) * float(np.tan(np.pi / 4 / corner.HOUSES))
        floors = int(rng.integers(self.config.floors[0], self.config.floors[1] + 1))
        parts = []
        for number in range(corner.HOUSES):
            s = corner.BEGIN_M + (number + 0.5) * (corner.END_M - corner.BEGIN_M) / corner.HOUSES
            house = buildings.house(rng, width, int(np.clip(floors + rng.integers(-1, 2), 2, 5)))
            parts.append(self.path.turned(self._put(house, s - width / 2, front, side), s))
        return parts

    def _put(self, part: Mesh, s: float, t: float, side: int, z: float = KERB_HEIGHT_M) -> Mesh:
        """Move a part built for the left side to (s, t) on the given side."""
        moved = mesh.place(part, [s, t, z])
        return mesh.mirror(moved, side)

    def _houses(self, rng: np.random.Generator, side: int, start: float, end: float) -> list[Mesh]:
        """Fill a block with houses: a closed row at the pavement, or detached ones behind front gardens."""
        parts, s = [], start + 0.5
        front = self.config.front_m(side)
        row = rng.random() < 0.6
        setback = 0.05 if row else float(rng.uniform(2.5, 6.0))
        floors = int(rng.integers(self.config.floors[0], self.config.floors[1] + 1))
        while s < end - 6:
            width = min(float(rng.uniform(7, 15)), end - s - 0.3)
            storeys = int(np.clip(floors + rng.integers(-1, 2), 2, 5))
            step = setback + float(rng.uniform(0, 0.6 if row else 1.5))
            parts.append(self._put(buildings.house(rng, width, storeys), s, front + step, side))
            if not row:
                parts += self._front_garden(rng, side, s, width)
            s += width + (0.0 if row and rng.random() < 0.9 else float(rng.uniform(1.5, 5.0)))
        return parts

    def _front_garden(self, rng: np.random.Generator, side: int, s: float, width: float) -> list[Mesh]:
        """Close a garden off towards the pavement, with something green behind."""
        length, kind = width * float(rng.uniform(0.6, 0.95)), rng.random()
        if kind < 0.4:
            border = furniture.wall(rng, length)
        elif kind < 0.65:
            border = furniture.fence(rng, length)
        else:
            border = plants.hedge(rng, length, float(rng.uniform(0.8, 1.7)))
        front = self.config.front_m(side)
        parts = [self._put(border, s, front + 0.1, side)]
        for _ in range(int(rng.integers(0, 3))):
            green = self._bushes[rng.integers(len(self._bushes))]
            spot = mesh.place(green, [0, 0, 0], rng.uniform(0, 6.28), rng.uniform(0.6, 1.3), rng.uniform(0, 99))
            parts.append(self._put(spot, s + rng.uniform(0, width), front + rng.uniform(1.2, 2.2), side))
        return parts

    def _park(self, rng: np.random.Generator, side: int, start: float, end: float) -> list[Mesh]:
        """Fill a block with trees behind a wall or a hedge, and a row of green farther back."""
        front = self.config.front_m(side)
        parts = []
        kind = rng.random()
        if kind < 0.4:
            parts.append(self._put(furniture.wall(rng, end - start), start, front + 0.2, side))
        elif kind < 0.75:
            parts.append(
                self._put(plants.hedge(rng, end - start, float(rng.uniform(1.0, 2.2))), start, front + 0.2, side)
            )
        for _ in range(int((end - start) / 6)):
            parts.append(self._tree(rng, side, rng.uniform(start, end), front + rng.uniform(2.5, 18)))
        for s in np.arange(start, end, 5.0):
            parts.append(self._tree(rng, side, s + rng.uniform(-1, 1), front + rng.uniform(18, 26), 1.3))
        return parts

    def _tree(self, rng: np.random.Generator, side: int, s: float, t: float, scale: float = 1.0) -> Mesh:
        """Plant a tree; what is far from the road gets larger and fewer leaves."""
        kinds = self._trees if t < FINE_LEAVES_M else self._far_trees
        proto = kinds[rng.integers(len(kinds))]
        turned = mesh.place(proto, [0, 0, 0], rng.uniform(0, 6.28), scale * rng.uniform(0.8, 1.2), rng.uniform(0, 99))
        return self._put(turned, s, t, side)

    def _pavement(self, rng: np.random.Generator, side: int, start: float, end: float) -> list[Mesh]:
        """Put parked cars, street trees, lamp posts and small things along a block."""
        config = self.config
        kerb = config.kerb_m(side)
        parts = []
        if config.parking_m[0 if side > 0 else 1] > 0:
            s = start + 6.0
            while s < end - 6.0:
                if rng.random() < config.parked_share:
                    vehicle = self._cars[rng.integers(len(self._cars))]
                    yaw = rng.normal(0, 0.02) + (np.pi if rng.random() < 0.06 else 0.0) + (np.pi if side > 0 else 0.0)
                    place = [s, side * (kerb - 1.08 + rng.normal(0, 0.08)), 0.0]
                    parts.append(mesh.place(vehicle, place, yaw, key=rng.uniform(0, 99)))
                s += rng.uniform(5.2, 6.6)
        edge = kerb + KERB_M + 0.35
        if rng.random() < 0.75:
            for s in np.arange(start + rng.uniform(1, 6), end - 2, config.tree_gap_m):
                if rng.random() < 0.85:
                    parts.append(self._tree(rng, side, s + rng.normal(0, 0.6), edge + 0.2, 0.85))
        for s in np.arange(start + rng.uniform(2, 12), end, rng.uniform(24, 34)):
            parts.append(self._put(furniture.lamp_post(rng), float(s), edge, side))
        for _ in range(rng.poisson(0.05 * (end - start))):
            walker = mesh.place(people.person(rng), [0, 0, 0], np.pi * rng.integers(2) + rng.normal(0, 0.3))
            t = rng.uniform(edge + 0.4, max(edge + 0.5, config.front_m(side) - 0.5))
            parts.append(self._put(walker, rng.uniform(start, end), t, side))
        for make, share in ((furniture.sign, 0.02), (furniture.bollard, 0.03), (furniture.bin_, 0.025)):
            for _ in range(rng.poisson(share * (end - start))):
                t = edge - 0.1 if make is not furniture.bin_ else config.front_m(side) - 0.4
                parts.append(self._put(make(rng), rng.uniform(start + 1, end - 1), t, side))
        return parts

    def _distance(self) -> list[Mesh]:
        """Build what closes the view: houses and tree lines behind the blocks, and hills."""
        rng = np.random.default_rng([self.config.seed, 6])
        parts = []
        for _ in range(150):
            side = rng.choice([-1, 1])
            s, t = rng.uniform(-BEHIND_M, self.config.length_m + 500), rng.uniform(60, 260)
            if s > self.config.length_m + 60:
                t = rng.uniform(-10, 200)
            w, h = rng.uniform(8, 30), rng.uniform(6, 17)
            tint = buildings.PLASTER_TINTS[rng.integers(12)] * rng.uniform(0.5, 0.9)
            low, high = [s, side * t, -4], [s + w, side * t + rng.uniform(8, 20), h]
            finish = Finish(Material.FAR, tint, rng.uniform(0, 99))
            if not isinstance(self.path, CornerPath) or self.path.is_clear(low, high, BESIDE_M):
                parts.append(mesh.box(low, high, finish))
        x = np.arange(-900, self.config.length_m + 810, 30.0)
        for side in (-1, 1):
            parts.append(_ridge(rng, x, side * 880.0))
        y = np.arange(-900, 901, 30.0)
        height = 14 + 10 * np.sin(y / 170 + rng.uniform(0, 6)) + 6 * np.sin(y / 61) + rng.uniform(0, 5, len(y))
        end = np.full_like(y, self.config.length_m + 780)
        crest = np.stack([np.stack([end, y, z], axis=1) for z in (np.full_like(y, -5), height)])
        parts.append(mesh.loft(crest, Finish(Material.FAR, HILL_TINT, 9.0)))
        return parts

    def _traffic(self) -> list[Body]:
        """Set cars going, one ahead in the rig's lane at its pace, the others oncoming, and people walking."""
        config = self.config
        rng = np.random.default_rng([config.seed, 9])
        lane = -0.5 * config.lane_m if config.lanes == 2 else -config.lane_m
        pace = config.speed_mps * float(rng.uniform(0.99, 1.05))
        bodies = [self._body(cars.car(rng), float(rng.uniform(14, 30)), pace, lane + float(rng.normal(0, 0.1)), 0.0)]
        start = float(rng.uniform(20, 50))
        while start < 2 * config.length_m:
            t, speed = float(rng.normal(0, 0.1)) - lane, float(rng.uniform(9, 11))
            bodies.append(self._body(cars.car(rng), start, -speed, t, 0.0))
            start += float(rng.uniform(0.5, 1.5)) * config.traffic_gap_m
        rng = np.random.default_rng([config.seed, 10])
        for _ in range(config.walkers):
            side, speed = int(rng.choice([-1, 1])), float(rng.uniform(1.0, 1.6)) * float(rng.choice([-1, 1]))
            t = side * (config.kerb_m(side) + KERB_M + 0.9)
            bodies.append(self._body(people.person(rng), float(rng.uniform(8, 60)), speed, t, KERB_HEIGHT_M))
        return bodies

    def _body(self, body: Mesh, start_m: float, speed_mps: float, t_m: float, up_m: float) -> Body:
        return Body(body, partial(_moving, self.path, start_m, speed_mps, t_m, up_m))


def _moving(path: Path, start_m: float, speed_mps: float, t_m: float, up_m: float, time_s: Values) -> Values:
    """Return T_world_body (n, 4, 4) at times (n,) of what keeps to one line along the street."""
    s = start_m + speed_mps * time_s
    poses = path.pose(s, np.full_like(s, t_m), np.pi if speed_mps < 0 else 0.0)
    poses[:, 2, 3] += up_m
    return poses


def _ridge(rng: np.random.Generator, s: Values, t: float) -> Mesh:
    height = 18 + 9 * np.sin(s / 190 + rng.uniform(0, 6)) + 5 * np.sin(s / 67) + rng.uniform(0, 4, len(s))
    crest = np.stack([np.stack([s, np.full_like(s, t), z], axis=1) for z in (np.full_like(s, -5), height)])
    return mesh.loft(crest, Finish(Material.FAR, HILL_TINT, 8.0))
