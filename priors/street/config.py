"""What one procedural street is made of: every number that differs between worlds, drawn from the seed."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from priors.errors import expect

POSITIVE = (
    "length_m",
    "lanes",
    "lane_m",
    "tree_gap_m",
    "bend_wave_m",
    "haze_m",
    "exposure",
    "camera_height_m",
    "speed_mps",
    "traffic_gap_m",
)
AT_LEAST_0 = ("seed", "bend_rad", "slope", "sun_strength", "sky_strength", "saturation", "blur_px", "walkers")
SHARES = ("parked_share", "cloud_cover")
"""Fields of StreetConfig by what they may be."""


@dataclass(frozen=True)
class StreetConfig:
    """The parameters of a world; `draw(seed)` fills them, and every further choice follows from `seed`."""

    seed: int
    """Seeds everything that is placed, painted or measured."""
    length_m: float = 340.0
    """Length of the built street ahead of the start, metres; what a frame shows does not depend on it within sight."""
    lanes: int = 2
    """Traffic lanes, both directions together."""
    lane_m: float = 3.3
    """Width of a lane, metres."""
    parking_m: tuple[float, float] = (2.1, 2.1)
    """Width of the parking strip to the left and to the right, metres; 0 = none."""
    pavement_m: tuple[float, float] = (2.6, 2.6)
    """Width of the pavement to the left and to the right, metres."""
    built_share: tuple[float, float] = (0.8, 0.6)
    """Share of the blocks with houses at the pavement, left and right; the others are gardens and parks."""
    parked_share: float = 0.7
    """Share of the parking places that are taken."""
    tree_gap_m: float = 11.0
    """Mean distance between street trees, metres."""
    floors: tuple[int, int] = (2, 4)
    """Smallest and largest number of floors of a house."""
    bend_rad: float = 0.08
    """Amplitude of the street's heading, radians."""
    bend_wave_m: float = 280.0
    """Wavelength of the bends, metres."""
    slope: float = 0.012
    """Amplitude of the road's slope, metres a metre."""
    sun_azimuth_rad: float = 0.8
    """Where the sun stands, from the street's direction, counter-clockwise seen from above."""
    sun_elevation_rad: float = 0.7
    """How high the sun stands."""
    sun_strength: float = 1.0
    """Direct light: 1 = clear day, 0.1 = overcast."""
    sky_strength: float = 1.5
    """Brightness of the sky; from about 1.3 on most of it is clipped to white."""
    cloud_cover: float = 0.4
    """Share of the sky that is cloud."""
    haze_m: float = 900.0
    """Distance at which haze takes 63 % of a surface's light."""
    exposure: float = 1.0
    """Factor on all light before the camera's curve."""
    warmth: float = 0.0
    """Colour balance of the camera: > 0 redder, < 0 bluer."""
    saturation: float = 1.3
    """Factor on colour differences; cameras exaggerate them."""
    blur_px: float = 0.5
    """Standard deviation of the lens's blur, pixels."""
    camera_height_m: float = 1.65
    """Height of the cameras above the road."""
    speed_mps: float = 10.0
    """Mean speed of the rig."""
    traffic_gap_m: float = 70.0
    """Mean distance between oncoming cars."""
    walkers: int = 2
    """Moving people; others stand still."""
    turn: int = 0
    """Where the street turns by 90 degrees: 1 = to the left, -1 = to the right, 0 = nowhere (corner.py)."""

    def __post_init__(self) -> None:
        values = vars(self)
        for name in POSITIVE:
            expect(values[name] > 0, f"street: {name}", values[name], "above 0")
        for name in AT_LEAST_0:
            expect(values[name] >= 0, f"street: {name}", values[name], "0 or more")
        for name in SHARES:
            expect(0 <= values[name] <= 1, f"street: {name}", values[name], "0 to 1")
        for name, widths_m in {"parking_m": self.parking_m, "pavement_m": self.pavement_m}.items():
            expect(min(widths_m) >= 0, f"street: {name}", widths_m, "0 or more")
        expect(all(0 <= share <= 1 for share in self.built_share), "street: built_share", self.built_share, "0 to 1")
        expect(self.turn in (-1, 0, 1), "street: turn", self.turn, "-1, 0 or 1")
        expect(1 <= self.floors[0] <= self.floors[1], "street: floors", self.floors, "1 or more, the smaller first")

    @classmethod
    def draw(cls, seed: int, length_m: float = 340.0) -> Self:
        """Draw a world's parameters from its seed."""
        expect(seed >= 0, "street: seed", seed, "0 or more")
        rng = np.random.default_rng([seed, 1])
        overcast = rng.random() < 0.2
        side = float(rng.choice([-1.0, 1.0]))
        return cls(
            seed=seed,
            length_m=length_m,
            lanes=int(rng.choice([2, 2, 3])),
            lane_m=rng.uniform(3.0, 3.6),
            parking_m=(2.1 * (rng.random() < 0.8), 2.1 * (rng.random() < 0.7)),
            pavement_m=(rng.uniform(1.8, 3.6), rng.uniform(1.8, 3.6)),
            built_share=(rng.uniform(0.4, 1.0), rng.uniform(0.3, 1.0)),
            parked_share=rng.uniform(0.5, 0.9),
            tree_gap_m=rng.uniform(8.0, 20.0),
            floors=(2, int(rng.integers(2, 5))),
            bend_rad=rng.uniform(0.0, 0.12),
            bend_wave_m=rng.uniform(220.0, 420.0),
            slope=rng.uniform(0.0, 0.02),
            sun_azimuth_rad=side * rng.uniform(0.5, 2.6),
            sun_elevation_rad=rng.uniform(0.55, 1.05),
            sun_strength=rng.uniform(0.08, 0.3) if overcast else rng.uniform(0.8, 1.1),
            sky_strength=rng.uniform(1.3, 2.4),
            cloud_cover=rng.uniform(0.8, 1.0) if overcast else rng.uniform(0.2, 0.6),
            haze_m=rng.uniform(1200.0, 6000.0),
            exposure=rng.uniform(0.6, 0.95),
            warmth=rng.uniform(-0.06, 0.06),
            saturation=rng.uniform(1.15, 1.55),
            blur_px=rng.uniform(0.4, 0.65),
            camera_height_m=rng.uniform(1.6, 1.7),
            speed_mps=rng.uniform(8.0, 13.0),
            traffic_gap_m=rng.uniform(30.0, 120.0),
            walkers=int(rng.integers(0, 4)),
        )

    @property
    def half_road_m(self) -> float:
        """Distance from the street's centre line to the outer edge of the lanes."""
        return 0.5 * self.lanes * self.lane_m

    def kerb_m(self, side: int) -> float:
        """Distance from the centre line to the kerb; side is 1 = left, -1 = right."""
        return self.half_road_m + self.parking_m[0 if side > 0 else 1]

    def front_m(self, side: int) -> float:
        """Distance from the centre line to the pavement's far edge, where the lots begin."""
        return self.kerb_m(side) + KERB_M + self.pavement_m[0 if side > 0 else 1]


KERB_M = 0.16
"""Width of the kerb stones, metres."""
KERB_HEIGHT_M = 0.12
"""Height of pavements and lots above the road, metres."""
