"""Videos, point clouds and meshes of a wall that is rendered exactly."""

import sys
from dataclasses import replace

import av
import cv2
import numpy as np
import pytest

from nerf.export import CloudConfig, write_cloud, write_mesh
from nerf.types import RenderedView
from nerf.video import VideoConfig, interpolate, write_video
from priors.errors import DataError
from priors.export.fusion import cells_of
from priors.types import Camera

CAMERA = Camera(np.array([[40.0, 0, 24], [0, 40, 15], [0, 0, 1]]), (31, 49))
WALL_M = 10.0
"""The world plane z = 10 m, seen by cameras that look along z."""


def wall(T_world_cam, camera):
    """Red grows with x; the top rows are sky."""
    height, width = camera.size
    depth_m = np.full((height, width), WALL_M - T_world_cam[2, 3], np.float32)
    opacity = np.ones_like(depth_m)
    opacity[:5] = 0.1
    rgb = np.zeros((height, width, 3), np.float32)
    rgb[..., 0] = np.arange(width) / width
    return RenderedView(rgb, depth_m, depth_m, opacity)


def poses(*z_m):
    found = np.tile(np.eye(4), (len(z_m), 1, 1))
    found[:, 2, 3] = z_m
    return found


def read_ply(path):
    """Read a PLY file by its header, as a stranger would."""
    head, body = path.read_bytes().split(b"end_header\n", 1)
    lines = head.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    kinds = {"float": "<f4", "uchar": "u1"}
    fields = [line.split()[1:] for line in lines if line.startswith("property")]
    count = next(int(line.split()[2]) for line in lines if line.startswith("element vertex"))
    points = np.frombuffer(body, np.dtype([(name, kinds[kind]) for kind, name in fields]))
    assert len(points) == count
    return points


def test_a_cloud_holds_the_opaque_pixels_in_the_world(tmp_path):
    config = CloudConfig(voxel_m=1e-3)
    count = write_cloud(tmp_path / "new" / "cloud.ply", wall, CAMERA, poses(0.0), config)
    points = read_ply(tmp_path / "new" / "cloud.ply")
    assert count == len(points) == 26 * 49
    assert points["z"] == pytest.approx(WALL_M)
    assert points["x"][:49] == pytest.approx((np.arange(49) - 24) / 40 * WALL_M, abs=1e-5)
    assert points["y"][::49] == pytest.approx((np.arange(5, 31) - 15) / 40 * WALL_M, abs=1e-5)
    assert points["red"][:49].tolist() == np.rint(np.arange(49) / 49 * 255).tolist()
    assert not points["blue"].any()


def test_a_cloud_has_one_point_a_voxel_over_all_views(tmp_path):
    config = CloudConfig(voxel_m=1.0)
    seen = []
    write_cloud(tmp_path / "a.ply", wall, CAMERA, poses(0.0, 1.0, 2.0), config, lambda: seen.append(1))
    points = read_ply(tmp_path / "a.ply")
    cells = cells_of(points, 1.0)
    assert len(set(cells.tolist())) == len(cells) < 26 * 49 / 4
    assert len(seen) == 3


def test_of_one_voxel_the_nearest_view_s_point_is_kept(tmp_path):
    def by_depth(T_world_cam, camera):
        view = wall(T_world_cam, camera)
        return replace(view, rgb=np.full_like(view.rgb, T_world_cam[2, 3] / 10))

    write_cloud(tmp_path / "a.ply", by_depth, CAMERA, poses(0.0, 4.0, 2.0), CloudConfig(voxel_m=0.5))
    points = read_ply(tmp_path / "a.ply")
    middle = (np.abs(points["x"]) < 2) & (np.abs(points["y"]) < 1)
    assert set(points["red"][middle].tolist()) == {102}, "seen from z = 4"
    assert set(points["red"].tolist()) == {0, 51, 102}, "what only the others see"


def test_pixels_that_see_two_surfaces_are_left_out(tmp_path):
    def edged(T_world_cam, camera):
        view = wall(T_world_cam, camera)
        median_m = view.depth_m.copy()
        median_m[:, :7] *= 1.2
        return replace(view, median_m=median_m)

    config = CloudConfig(voxel_m=1e-3)
    assert write_cloud(tmp_path / "a.ply", edged, CAMERA, poses(0.0), config) == 26 * 42
    assert write_cloud(tmp_path / "a.ply", edged, CAMERA, poses(0.0), replace(config, agreement=0.3)) == 26 * 49


@pytest.mark.parametrize(("write", "name"), [(write_cloud, "cloud.obj"), (write_mesh, "mesh.abc")])
def test_a_name_that_cannot_be_is_refused_before_anything_is_rendered(tmp_path, write, name):
    def never(pose, camera):
        raise AssertionError

    with pytest.raises(DataError, match=r"ends in .ply"):
        write(tmp_path / name, never, CAMERA, poses(0.0), CloudConfig())


def test_a_cloud_follows_the_camera_s_pose(tmp_path):
    pose = poses(0.0)
    pose[0, :3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]  # looks along the world's x
    pose[0, :3, 3] = [1, 2, 3]
    pose[0, 2, 3] = 0  # what `wall` takes for the camera's place
    write_cloud(tmp_path / "a.ply", wall, CAMERA, pose, CloudConfig(voxel_m=1e-3))
    assert read_ply(tmp_path / "a.ply")["x"] == pytest.approx(11.0)


def test_far_and_thin_pixels_are_left_out(tmp_path):
    half = wall(np.eye(4), CAMERA)
    half.depth_m[:, :20] = half.median_m[:, :20] = 11.0
    config = CloudConfig(farthest_m=10.5, voxel_m=1e-3)
    assert write_cloud(tmp_path / "a.ply", lambda *_: half, CAMERA, poses(0.0), config) == 26 * 29
    config = CloudConfig(opacity=0.05, voxel_m=1e-3)
    assert write_cloud(tmp_path / "b.ply", wall, CAMERA, poses(0.0), config) == 31 * 49
    with pytest.raises(DataError, match="above 0"):
        CloudConfig(voxel_m=0)


@pytest.mark.parametrize(
    ("config", "says"),
    [
        (CloudConfig(farthest_m=9.9), "within 9.9 m"),
        (CloudConfig(agreement=1e-9), "--agreement"),
        (CloudConfig(opacity=0.9), "of opacity 0.9"),
    ],
)
def test_a_cloud_of_a_fog_is_not_written(tmp_path, config, says):
    def fog(T_world_cam, camera):
        view = wall(T_world_cam, camera)
        return replace(
            view, opacity=0.8 * view.opacity, median_m=1.5 * view.median_m if "agree" in says else view.median_m
        )

    for count in (1, 2):
        seen = "the view holds" if count == 1 else "2 views hold"
        with pytest.raises(DataError, match=rf"a.ply: not written: {seen} no point .*({says})"):
            write_cloud(tmp_path / "a.ply", fog, CAMERA, poses(*[0.0] * count), config)
    assert not list(tmp_path.iterdir())


def test_a_cloud_that_fails_leaves_the_old_file(tmp_path):
    write_cloud(tmp_path / "a.ply", wall, CAMERA, poses(0.0), CloudConfig())
    old = (tmp_path / "a.ply").read_bytes()

    def fails(pose, camera):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_cloud(tmp_path / "a.ply", fails, CAMERA, poses(0.0), CloudConfig())
    assert (tmp_path / "a.ply").read_bytes() == old
    assert [path.name for path in tmp_path.iterdir()] == ["a.ply"]


def test_a_mesh_without_open3d_says_what_is_missing(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(DataError, match=r"needs open3d.*roadprior\[mesh\].*libusb-1.0-0 libgl1 libegl1"):
        write_mesh(tmp_path / "mesh.ply", wall, CAMERA, poses(0.0), CloudConfig())

    def broken(name):
        raise OSError("libGL.so.1: cannot open shared object file")

    monkeypatch.setattr("nerf.export.import_module", broken)
    with pytest.raises(DataError, match=r"libGL.so.1: cannot open shared object file.*libusb-1.0-0 libgl1"):
        write_mesh(tmp_path / "mesh.ply", wall, CAMERA, poses(0.0), CloudConfig())


def test_a_video_has_every_picture_in_order(tmp_path):
    steps = []
    path = tmp_path / "new" / "path.mp4"
    count = write_video(path, wall, CAMERA, poses(0.0, 4.0, 8.0), VideoConfig(steps=3, fps=10), lambda: steps.append(1))
    with av.open(str(path)) as film:
        stream = film.streams.video[0]
        pictures = [frame.to_ndarray(format="rgb24") for frame in film.decode(stream)]
    assert count == len(pictures) == len(steps) == 7
    assert stream.codec_context.name == "h264"
    assert pictures[0].shape == (62, 50, 3)  # colour over depth, odd width made even
    assert stream.average_rate == 10
    red = [picture[10:25, 40:, 0].mean() for picture in pictures]
    assert min(red) > 150  # colour is above
    green = [picture[40:60, :, 1].mean() for picture in pictures]
    assert green[0] > green[-1] + 100  # depth is below: green in the middle, red near
    assert [p.name for p in path.parent.iterdir()] == ["path.mp4"]


def test_poses_are_interpolated_on_the_shortest_turn():
    pair = poses(0.0, 2.0)
    pair[1, :3, :3] = cv2.Rodrigues(np.array([0, np.pi / 2, 0]))[0]
    found = interpolate(pair, 2)
    assert len(found) == 3
    assert np.allclose(found[[0, 2]], pair)
    assert np.allclose(found[1, :3, :3], cv2.Rodrigues(np.array([0, np.pi / 4, 0]))[0])
    assert found[1, :3, 3] == pytest.approx([0, 0, 1])
    assert len(interpolate(poses(0.0), 4)) == 1


def test_videos_that_cannot_be_written(tmp_path):
    with pytest.raises(DataError, match=r"ends in .mp4"):
        write_video(tmp_path / "a.avi", wall, CAMERA, poses(0.0))
    with pytest.raises(DataError, match="no pictures"):
        write_video(tmp_path / "a.mp4", wall, CAMERA, poses())
    with pytest.raises(DataError, match="--steps 0: expected a whole number from 1"):
        VideoConfig(steps=0)
    assert not list(tmp_path.iterdir())


def test_a_cloud_on_a_full_disk_names_the_file(tmp_path, full_disk):
    with full_disk(1000), pytest.raises(OSError) as told:
        write_cloud(tmp_path / "a.ply", wall, CAMERA, poses(0.0), CloudConfig())
    assert told.value.filename == str(tmp_path / "a.ply")
    assert not list(tmp_path.iterdir())
