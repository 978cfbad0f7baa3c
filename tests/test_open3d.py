"""What needs open3d (the extra mesh): meshes and clouds of a street whose every surface is known.

Skipped where open3d is not installed, unless ROADPRIOR_OPEN3D=required: then it is a failure.
"""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_nerf_export import CAMERA, WALL_M, poses, wall

from nerf.export import CloudConfig, write_cloud, write_mesh
from nerf.pictures import RenderedView
from priors.drives import open_drive
from priors.errors import DataError
from priors.export.fusion import SEEN
from priors.export.ply import write_ply
from priors.street import rig
from priors.street.materials import Material
from priors.street.street import Street
from priors.types import Camera, Matrix

SIZE = (94, 310)
VOXEL_M = 0.15
CONFIG = CloudConfig(farthest_m=25.0, voxel_m=VOXEL_M)
WALLS = (Material.PLASTER, Material.BRICK)


@pytest.fixture(scope="module")
def o3d() -> Any:
    try:
        import open3d
    except (ImportError, OSError) as error:
        if os.environ.get("ROADPRIOR_OPEN3D") == "required":
            pytest.fail(f"open3d cannot be imported: {error}")
        pytest.skip(f"open3d cannot be imported: {error}")
    return open3d


class Exact:
    """A street rendered exactly, as a perfect field would be, and the truth about it."""

    def __init__(self, o3d: Any) -> None:
        self.street = Street(7)
        self.camera = rig.camera(SIZE)
        self.T_world_cam = np.array([self.street.T_world_cam(0.1 * i) for i in range(0, 12, 2)])
        still = self.street.world.still
        self.corners, self.material = still.corners.astype(np.float32), still.material
        faces = np.arange(3 * len(self.corners), dtype=np.uint32).reshape(-1, 3)
        self._scene = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(o3d.core.Tensor(self.corners.reshape(-1, 3)), o3d.core.Tensor(faces))
        self._o3d = o3d
        self._views: dict[bytes, RenderedView] = {}

    def __call__(self, T_world_cam: Matrix, camera: Camera) -> RenderedView:
        """Render a view; cars and people that move are left out."""
        key = T_world_cam.tobytes()
        if key not in self._views:
            view = self.street.view(T_world_cam, camera)
            way_m, _ = self.nearest(self.points(T_world_cam, camera, view.depth_m))
            still = np.linalg.norm(way_m, axis=1).reshape(camera.size) < 0.01
            solid = ((view.depth_m > 0) & still).astype(np.float32)
            rgb = (view.image / 255).astype(np.float32)
            self._views[key] = RenderedView(rgb, view.depth_m, view.depth_m, solid)
        return self._views[key]

    def nearest(self, points_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the ways (n, 3) from the nearest true surface to points (n, 3), metres, and its triangles (n,)."""
        query = self._o3d.core.Tensor(np.ascontiguousarray(points_m, np.float32))
        found = self._scene.compute_closest_points(query)
        return points_m - found["points"].numpy(), found["primitive_ids"].numpy()

    def normals(self, triangles: np.ndarray) -> np.ndarray:
        """Return the triangles' unit normals (n, 3), towards the first camera."""
        a, b, c = np.moveaxis(self.corners[triangles].astype(float), 1, 0)
        normal = np.cross(b - a, c - a)
        normal *= np.sign(np.sum(normal * (self.T_world_cam[0, :3, 3] - a), axis=1, keepdims=True))
        return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)

    @staticmethod
    def points(T_world_cam: Matrix, camera: Camera, depth_m: np.ndarray) -> np.ndarray:
        rows, columns = np.mgrid[: camera.size[0], : camera.size[1]]
        pixels = np.stack([columns, rows, np.ones_like(rows)], axis=-1).reshape(-1, 3)
        seen = pixels @ np.linalg.inv(camera.K).T * depth_m.reshape(-1, 1)
        return seen @ T_world_cam[:3, :3].T + T_world_cam[:3, 3]


@pytest.fixture(scope="module")
def exact(o3d: Any) -> Exact:
    return Exact(o3d)


def test_a_mesh_of_the_street_lies_on_its_surfaces(o3d: Any, exact: Exact, tmp_path: Path) -> None:
    path = tmp_path / "new" / "street.ply"
    count = write_mesh(path, exact, exact.camera, exact.T_world_cam, CONFIG)
    mesh = o3d.io.read_triangle_mesh(str(path))
    vertices = np.asarray(mesh.vertices)
    assert count == len(mesh.triangles) > 50_000
    way_m, triangle = exact.nearest(vertices)
    away_m, normal = np.linalg.norm(way_m, axis=1), exact.normals(triangle)
    assert np.median(away_m) < 0.02
    assert np.percentile(away_m, 95) < VOXEL_M
    on_wall = np.isin(exact.material[triangle], WALLS) & (np.abs(normal[:, 2]) < 0.01)
    assert np.count_nonzero(on_wall) > 2000
    before_m = np.sum(way_m * normal, axis=1)[on_wall]
    assert abs(np.median(before_m)) < 0.005, "neither before the walls nor behind them: half a pixel's shift is 0.045 m"
    facing = np.sum(np.asarray(mesh.vertex_normals)[on_wall] * normal[on_wall], axis=1)
    assert np.median(facing) > 0.99, "outside is where the camera was"
    pixel = np.asarray(mesh.vertex_colors)
    assert pixel.min() >= 0 and pixel.max() <= 1 and pixel.std() > 0.05


def test_the_mesh_covers_the_walls_that_were_seen(o3d: Any, exact: Exact, tmp_path: Path) -> None:
    write_mesh(tmp_path / "street.ply", exact, exact.camera, exact.T_world_cam, CONFIG)
    mesh = o3d.t.io.read_triangle_mesh(str(tmp_path / "street.ply"))
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(mesh)
    pose = exact.T_world_cam[2]
    view = exact(pose, exact.camera)
    points = exact.points(pose, exact.camera, view.depth_m)
    solid = ((view.opacity > 0) & (view.depth_m < 20)).ravel()
    away_m = scene.compute_distance(o3d.core.Tensor(points[solid].astype(np.float32))).numpy()
    assert np.percentile(away_m, 90) < VOXEL_M


def test_a_cloud_of_the_street_lies_on_its_surfaces(o3d: Any, exact: Exact, tmp_path: Path) -> None:
    count = write_cloud(tmp_path / "street.ply", exact, exact.camera, exact.T_world_cam, CONFIG)
    cloud = o3d.io.read_point_cloud(str(tmp_path / "street.ply"))
    points = np.asarray(cloud.points)
    assert count == len(points) > 5000
    way_m, _ = exact.nearest(points)
    assert np.linalg.norm(way_m, axis=1).max() < 0.01
    cells = np.floor(points / VOXEL_M)
    assert len(np.unique(cells, axis=0)) > 0.99 * count, "one point a voxel"


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".glb"])
def test_every_format_of_a_mesh_is_read_by_open3d(o3d: Any, tmp_path: Path, suffix: str) -> None:
    count = write_mesh(tmp_path / f"a{suffix}", wall, CAMERA, poses(0.0, 0.0), CloudConfig(voxel_m=0.2))
    mesh = o3d.io.read_triangle_mesh(str(tmp_path / f"a{suffix}"))
    assert count == len(mesh.triangles) > 1000
    vertices, colours = np.asarray(mesh.vertices), np.asarray(mesh.vertex_colors)
    assert vertices[:, 2] == pytest.approx(WALL_M, abs=0.02)
    red = (vertices[:, 0] / WALL_M * 40 + 24) / 49  # as `wall` paints it
    shown = np.where(colours[:, 0] <= 0.0031308, 12.92 * colours[:, 0], 1.055 * colours[:, 0] ** (1 / 2.4) - 0.055)
    assert (shown if suffix == ".glb" else colours[:, 0]) == pytest.approx(red, abs=0.05)
    assert [item.name for item in tmp_path.iterdir()] == [f"a{suffix}"]


def test_points_with_more_than_a_place_are_read_by_open3d(o3d: Any, tmp_path: Path, capfd: Any) -> None:
    points = np.zeros(3, SEEN)
    points["x"], points["red"], points["confidence"], points["views"] = (1, 2, 3), 255, 0.5, (1, 2, 70_000)
    for origin_m in ((0.0, 0.0, 0.0), (455000.0, 5428000.0, 110.0)):
        write_ply(tmp_path / "a.ply", points, origin_m)
        found = o3d.t.io.read_point_cloud(str(tmp_path / "a.ply")).point
        assert found.positions.numpy() == pytest.approx(np.array([[1.0, 0, 0], [2, 0, 0], [3, 0, 0]]) + origin_m)
        assert found.colors.numpy().tolist() == [[255, 0, 0]] * 3
        assert found["confidence"].numpy().ravel().tolist() == [0.5] * 3
        assert found["views"].numpy().ravel().tolist() == [1, 2, 70_000]
    assert "WARNING" not in "".join(capfd.readouterr())


def test_views_without_a_surface_are_told(o3d: Any, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"the view holds no surface of .* within 5 m"):
        write_mesh(tmp_path / "none.ply", wall, CAMERA, poses(0.0), CloudConfig(farthest_m=5))
    with pytest.raises(DataError, match=r"the view holds no surface of .* within 60 m"):
        write_mesh(tmp_path / "none.ply", wall, CAMERA, poses(9.999), CloudConfig(voxel_m=50.0))
    assert not list(tmp_path.iterdir())


def test_the_command_writes_the_mesh_of_a_fitted_street(exact: Exact, o3d: Any, tmp_path: Path) -> None:
    """From the street to a fit with a LiDAR prior and its mesh, by the installed commands."""
    run(tmp_path, "priors street street --frames 10 --size 208x64 --seed 7")
    run(tmp_path, "priors build street --method lidar")
    prior = next((tmp_path / "cache").glob("*/lidar-*"))
    run(tmp_path, f"nerf fit street --prior {prior} --steps 200 --run run")
    told = run(tmp_path, "nerf export run --kind mesh --farthest-m 20 --voxel-m 0.2")
    mesh = o3d.io.read_triangle_mesh(str(tmp_path / "run" / "mesh.ply"))
    assert told.strip() == f"wrote run/mesh.ply: {len(mesh.triangles)} triangles"
    T_street_drive = exact.street.T_world_cam(0.0) @ np.linalg.inv(open_drive(tmp_path / "street")[0].T_world_cam)
    places = np.asarray(mesh.vertices) @ T_street_drive[:3, :3].T + T_street_drive[:3, 3]
    way_m, _ = exact.nearest(places)
    assert np.median(np.linalg.norm(way_m, axis=1)) < 0.5, "a short fit is rough; elsewhere it would be metres"


def run(folder: Path, command: str) -> str:
    """Run an installed command; returns what it prints."""
    program, *arguments = command.split()
    parts = [str(Path(sys.executable).parent / program), *arguments]
    done = subprocess.run(parts, cwd=folder, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout
