"""Pictures of the street: rays through pixels, extra ones where the picture has edges, light, lens, sensor."""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from priors import geometry
from priors.street.light import Light, develop
from priors.street.scene import Hits, Scene
from priors.street.textures import Patch, albedo
from priors.street.world import World
from priors.types import Camera, FloatMap, Image, Mask, Matrix

Floats = npt.NDArray[np.float32]
SUBPIXELS = np.array([[0.25, -0.25], [-0.25, 0.25], [-0.25, -0.25], [0.25, 0.25]], np.float32)
NEAR_DEPTHS = 1.04
"""Neighbouring pixels whose depths differ by this factor, or whose materials or directions differ, make an edge."""


@dataclass(frozen=True, slots=True)
class View:
    """What a camera sees: image, and the truth at the pixels' centres."""

    image: Image
    """(h, w, 3) uint8 RGB."""
    depth_m: FloatMap
    """(h, w) exact camera-z depth, metres; 0 = sky."""
    sky: Mask
    """(h, w) True where the pixel's centre sees sky."""


class Renderer:
    """Draws views of one world."""

    def __init__(self, world: World, scene: Scene) -> None:
        self._config, self._scene = world.config, scene
        meshes = [world.still, *(body.mesh for body in world.bodies)]
        self._uv = np.concatenate([m.uv for m in meshes])
        self._material = np.concatenate([m.material for m in meshes])
        self._tint = np.concatenate([m.tint for m in meshes])
        self._key = np.concatenate([m.key for m in meshes])
        self._light = Light(world.config)

    def surfaces(self) -> tuple[npt.NDArray[np.uint8], Floats]:
        """Return material (n,) and tint (n, 3) of the scene's triangles."""
        return self._material, self._tint

    def view(self, T_world_cam: Matrix, camera: Camera, time_s: float, rng: np.random.Generator) -> View:
        """Draw what a camera at a pose sees at a time; rng makes the sensor's noise."""
        height, width = camera.size
        directions = geometry.rays(camera).reshape(-1, 3)
        origin = T_world_cam[:3, 3].astype(np.float32)
        rays = (directions @ T_world_cam[:3, :3].T).astype(np.float32)
        hits = self._scene.cast(_spread(origin, len(rays)), rays, time_s)
        pixel = 1.0 / camera.fx
        radiance = self._radiance(origin, rays, hits, time_s, pixel)
        # Smoothing happens in display values, so that a bright sky does not eat thin things against it.
        shown = np.minimum(radiance, 1.6)
        edges = np.flatnonzero(self._edges(hits, (height, width)))
        if edges.size:
            shown[edges] = self._finer(shown[edges], directions[edges], T_world_cam, camera, time_s, pixel)
        depth = np.where(np.isfinite(hits.distance), hits.distance, np.float32(0)).reshape(height, width)
        image = self._sensor(shown.reshape(height, width, 3), rng)
        return View(image, depth, (hits.triangle < 0).reshape(height, width))

    def _finer(
        self, coarse: Floats, directions: npt.NDArray[np.float64], T_world_cam: Matrix, camera: Camera, time_s: float,
        pixel: float,
    ) -> Floats:  # fmt: skip
        """Average over rays spread across the pixel."""
        total = coarse * 0
        origin = T_world_cam[:3, 3].astype(np.float32)
        for offset in SUBPIXELS:
            moved = directions + np.array([offset[0] / camera.K[0, 0], offset[1] / camera.K[1, 1], 0])
            rays = (moved @ T_world_cam[:3, :3].T).astype(np.float32)
            hits = self._scene.cast(_spread(origin, len(rays)), rays, time_s)
            total += np.minimum(self._radiance(origin, rays, hits, time_s, 0.5 * pixel), 1.6)
        return total / np.float32(len(SUBPIXELS))

    def _edges(self, hits: Hits, size: tuple[int, int]) -> Mask:
        """Find pixels next to another surface, (h, w)."""
        depth = np.where(np.isfinite(hits.distance), hits.distance, np.float32(1e4)).reshape(size)
        kernel = np.ones((3, 3), np.uint8)
        jump = cv2.dilate(depth, kernel) > NEAR_DEPTHS * cv2.erode(depth, kernel)
        kind = np.where(hits.triangle >= 0, self._material[hits.triangle] + 1, 0).astype(np.uint8).reshape(size)
        jump |= cv2.dilate(kind, kernel) != cv2.erode(kind, kernel)
        # A road seen at a grazing angle is no edge: its depth jumps from row to row, its kind does not.
        ground = kind <= 4
        flat = ground & (cv2.dilate(kind, kernel) == cv2.erode(kind, kernel))
        return (jump & ~(flat & (kind > 0))).reshape(-1)

    def _radiance(self, origin: Floats, rays: Floats, hits: Hits, time_s: float, pixel: float) -> Floats:
        """Return the light (n, 3) that arrives along rays from one origin."""
        length = np.sqrt(np.einsum("ni,ni->n", rays, rays))
        unit = rays / length[:, None]
        out = np.empty((len(rays), 3), np.float32)
        seen = np.flatnonzero(hits.triangle >= 0)
        empty = np.flatnonzero(hits.triangle < 0)
        out[empty] = self._light.sky(unit[empty])
        triangle, view, normal = hits.triangle[seen], unit[seen], hits.normal[seen]
        range_m = hits.distance[seen] * length[seen]
        place = origin + view * range_m[:, None]
        grazing = np.maximum(np.abs(np.einsum("ni,ni->n", normal, view)), 0.02)
        patch = Patch(
            self._surface(triangle, hits.weights[seen]), self._key[triangle], self._tint[triangle],
            (range_m * np.float32(pixel) / np.sqrt(grazing)).astype(np.float32), self._config,
        )  # fmt: skip
        material = self._material[triangle]
        colour = albedo(material, patch)
        lit = self._lit(place + normal * np.float32(0.01), normal, time_s)
        open_ = np.full(len(seen), 1.0, np.float32)
        out[seen] = self._light.haze(self._light.shade(colour, material, normal, view, lit, open_), range_m)
        return out

    def _surface(self, triangle: npt.NDArray[np.int32], weights: Floats) -> Floats:
        corners = self._uv[triangle]
        a = corners[:, 0]
        return a + weights[:, :1] * (corners[:, 1] - a) + weights[:, 1:] * (corners[:, 2] - a)

    def _lit(self, place: Floats, normal: Floats, time_s: float) -> Floats:
        """Return 1 where the sun reaches a place, 0 in shadow."""
        lit = np.zeros(len(place), np.float32)
        facing = np.flatnonzero(normal @ self._light.to_sun > 0)
        dark = self._scene.blocked(np.ascontiguousarray(place[facing]), self._light.to_sun, time_s)
        lit[facing[~dark]] = 1.0
        return lit

    def _sensor(self, radiance: Floats, rng: np.random.Generator) -> Image:
        """Add vignetting, exposure and noise, and quantise."""
        height, width = radiance.shape[:2]
        y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j].astype(np.float32)
        falloff = 1 - np.float32(0.10) * (0.85 * x * x + 0.15 * y * y)
        gain = self._config.exposure * (1 + rng.normal(0, 0.02))
        values = develop(radiance * falloff[..., None], gain, self._config.warmth + rng.normal(0, 0.004))
        sigma = 0.8 + 0.09 * np.sqrt(values)
        values += sigma * rng.standard_normal(values.shape, dtype=np.float32)
        return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def _spread(origin: Floats, count: int) -> Floats:
    return np.ascontiguousarray(np.broadcast_to(origin, (count, 3)))
