"""Pictures of the street: rays through pixels, extra ones where the picture has edges, light, lens, sensor."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from priors import geometry
from priors.street.light import Light, Surface, develop
from priors.street.materials import CURVED, LAST_GROUND
from priors.street.openness import Openness
from priors.street.patch import Patch
from priors.street.raycast import Hits, RayCaster
from priors.street.textures import albedo
from priors.street.world import World
from priors.types import Camera, FloatMap, Image, Mask, Matrix

Floats = npt.NDArray[np.floating]
SUBPIXELS = np.array([[0.33, -0.12, 0], [-0.27, -0.23, 0], [-0.06, 0.35, 0]], np.float32)
"""Where the extra rays of an edge pixel go, pixels from its centre."""
WHITE = 1.6
"""Radiance beyond which a pixel is white at any exposure."""
NEAR_DEPTHS = 1.04
"""Neighbouring pixels whose depths differ by this factor make an edge."""


@dataclass(frozen=True, slots=True)
class StreetView:
    """What a camera sees: image, and the truth at the pixels' centres."""

    image: Image
    """(h, w, 3) uint8 RGB."""
    depth_m: FloatMap
    """(h, w) exact camera-z depth, metres; 0 = sky."""
    sky: Mask
    """(h, w) True where the pixel's centre sees sky."""


class StreetRenderer:
    """Draws views of one world."""

    def __init__(self, world: World, caster: RayCaster) -> None:
        self._config, self._caster = world.config, caster
        meshes = [world.still, *(body.mesh for body in world.bodies)]
        self._uv = np.concatenate([m.uv for m in meshes])
        self._normal = np.concatenate([m.normal for m in meshes])
        self._material = np.concatenate([m.material for m in meshes])
        self._tint = np.concatenate([m.tint for m in meshes])
        self._key = np.concatenate([m.key for m in meshes])
        self._light = Light(world.config)
        self._openness = Openness(world.config, world.path, caster)

    def surfaces(self) -> tuple[npt.NDArray[np.uint8], Floats]:
        """Return material (n,) and tint (n, 3) of the triangles."""
        return self._material, self._tint

    def view(self, T_world_cam: Matrix, camera: Camera, time_s: float, rng: np.random.Generator) -> StreetView:
        """Draw what a camera at a pose sees at a time; rng makes the sensor's noise."""
        directions = geometry.rays(camera).astype(np.float32).reshape(-1, 3)
        pixel = 1.0 / camera.fx
        focal = np.array([camera.K[0, 0], camera.K[1, 1], 1], np.float32)
        hits, shown, lit = self._look(directions, T_world_cam, time_s, pixel)
        edges = np.flatnonzero(self._edges(hits, lit, camera.size))
        if edges.size:
            total = shown[edges]
            for offset in SUBPIXELS:
                moved = directions[edges] + offset / focal
                total += self._look(moved, T_world_cam, time_s, 0.5 * pixel)[1]
            shown[edges] = total / np.float32(len(SUBPIXELS) + 1)
        depth = np.where(np.isfinite(hits.distance), hits.distance, np.float32(0)).reshape(camera.size)
        image = self._sensor(shown.reshape(*camera.size, 3), rng)
        return StreetView(image, depth, (hits.triangle < 0).reshape(camera.size))

    def _look(
        self, directions: Floats, T_world_cam: Matrix, time_s: float, pixel: float
    ) -> tuple[Hits, Floats, Floats]:
        """Follow rays (n, 3), camera axes: what they meet, the light (n, 3) they bring, the share of sun (n,) there."""
        rays = directions @ T_world_cam[:3, :3].T.astype(np.float32)
        origin = T_world_cam[:3, 3].astype(np.float32)
        hits = self._caster.cast(origin[None], rays, time_s)
        radiance, lit = self._radiance(origin, rays, hits, time_s, pixel)
        # Clipped before averaging, or a bright sky would eat thin things against it.
        return hits, np.minimum(radiance, WHITE), lit

    def _edges(self, hits: Hits, lit: Floats, size: tuple[int, int]) -> Mask:
        """Find pixels next to another surface or on a shadow's edge, (h * w,)."""
        depth = np.where(np.isfinite(hits.distance), hits.distance, np.float32(1e4)).reshape(size)
        kind = np.where(hits.triangle >= 0, self._material[hits.triangle] + 1, 0).astype(np.uint8).reshape(size)
        kernel = np.ones((3, 3), np.uint8)

        def differs(values: npt.NDArray[Any]) -> Mask:
            return np.asarray(cv2.dilate(values, kernel) != cv2.erode(values, kernel))

        borders = differs(kind)
        # A road seen at a grazing angle is no edge: its depth jumps from row to row, its kind does not.
        on_ground = (kind > 0) & (kind <= LAST_GROUND + 1)
        jump = (cv2.dilate(depth, kernel) > NEAR_DEPTHS * cv2.erode(depth, kernel)) & ~on_ground
        return np.asarray(borders | jump | differs(lit.reshape(size))).reshape(-1)

    def _radiance(self, origin: Floats, rays: Floats, hits: Hits, time_s: float, pixel: float) -> tuple[Floats, Floats]:
        """Return the light (n, 3) that arrives along rays from one origin, and the share of sun where they end."""
        length = np.sqrt(np.einsum("ni,ni->n", rays, rays))
        unit = rays / length[:, None]
        out, lit = np.empty((len(rays), 3), np.float32), np.zeros(len(rays), np.float32)
        solid, sky = np.flatnonzero(hits.triangle >= 0), np.flatnonzero(hits.triangle < 0)
        out[sky] = self._light.sky(unit[sky])
        triangle, view, flat, weights = hits.triangle[solid], unit[solid], hits.normal[solid], hits.weights[solid]
        range_m = hits.distance[solid] * length[solid]
        place = origin + view * range_m[:, None]
        grazing = np.maximum(np.abs(np.einsum("ni,ni->n", flat, view)), 0.02)
        footprint = (range_m * np.float32(pixel) / np.sqrt(grazing)).astype(np.float32)
        material = self._material[triangle]
        patch = Patch(
            self._blend(self._uv, triangle, weights), self._key[triangle], self._tint[triangle], footprint, self._config
        )
        normal = self._smooth(triangle, weights, flat, material)
        lit[solid] = self._lit(place + flat * np.float32(0.01), normal, time_s)
        open_ = self._openness.at(place, flat)
        surface = Surface(albedo(material, patch), material, normal, view, lit[solid], open_)
        out[solid] = self._light.haze(self._light.shade(surface), range_m)
        return out, lit

    def _blend(self, table: Floats, triangle: npt.NDArray[np.int32], weights: Floats) -> Floats:
        """Interpolate what a table (triangles, 3, c) has at the corners: (n, c)."""
        corners = table[triangle]
        a = corners[:, 0]
        return np.asarray(a + weights[:, :1] * (corners[:, 1] - a) + weights[:, 1:] * (corners[:, 2] - a))

    def _smooth(
        self, triangle: npt.NDArray[np.int32], weights: Floats, flat: Floats, material: npt.NDArray[np.uint8]
    ) -> Floats:
        """Return normals (n, 3) of the curved surface where there is one, else the flat ones."""
        normal = flat.copy()
        curved = np.flatnonzero(CURVED[material])
        bent = self._blend(self._normal, triangle[curved], weights[curved])
        length = np.sqrt(np.einsum("ni,ni->n", bent, bent))
        bent *= np.sign(np.einsum("ni,ni->n", bent, flat[curved]))[:, None]
        usable = length > 0.5
        normal[curved[usable]] = bent[usable] / length[usable, None]
        return normal

    def _lit(self, place: Floats, normal: Floats, time_s: float) -> Floats:
        """Return 1 where the sun reaches a place, 0 in shadow."""
        lit = np.zeros(len(place), np.float32)
        facing = np.flatnonzero(normal @ self._light.to_sun > 0)
        dark = self._caster.blocked(np.ascontiguousarray(place[facing]), self._light.to_sun, time_s)
        lit[facing[~dark]] = 1.0
        return lit

    def _sensor(self, radiance: Floats, rng: np.random.Generator) -> Image:
        """Add vignetting, exposure and noise, and quantise."""
        height, width = radiance.shape[:2]
        y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j].astype(np.float32)
        falloff = 1 - np.float32(0.10) * (0.85 * x * x + 0.15 * y * y)
        gain = self._config.exposure * (1 + rng.normal(0, 0.02))
        blurred = cv2.GaussianBlur(radiance * falloff[..., None], (3, 3), self._config.blur_px)
        values = develop(blurred, gain, self._config.warmth + rng.normal(0, 0.004), self._config.saturation)
        sigma = 1.0 + 0.10 * np.sqrt(values)
        values += sigma * rng.standard_normal(values.shape, dtype=np.float32)
        return np.clip(np.rint(values), 0, 255).astype(np.uint8)
