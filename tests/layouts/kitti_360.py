"""KITTI-360 as its documentation describes it: four trees, of one wall seen from a car that drives ahead."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from factories import BASELINE_M, SIZE, STEP_M, projection, row, scene_points, write_bin, write_images
from scipy.spatial.transform import Rotation

from priors.geometry import invert, transform

SEQUENCE = "2013_05_28_drive_0000_sync"
R_RECT = Rotation.from_euler("xyz", [0.3, -0.5, 0.1], degrees=True).as_matrix()
T_VELO_CAM0 = np.array([[0.02, -0.03, 0.99935, 0.8], [-0.9998, 0, 0.02, 0.3], [0, -0.9995, -0.03, -0.18], [0, 0, 0, 1]])
T_POSE_CAM0 = np.array([[0.037, -0.1, 0.994, 1.57], [0.999, 0, -0.037, -0.2], [0.004, 0.995, 0.1, -1.8], [0, 0, 0, 1]])
for T in (T_VELO_CAM0, T_POSE_CAM0):
    u, _, vt = np.linalg.svd(T[:3, :3])
    T[:3, :3] = u @ vt


def rectified() -> np.ndarray:
    """(4, 4) from camera 0 as it is to camera 0 as it is rectified."""
    T = np.eye(4)
    T[:3, :3] = R_RECT
    return T


def write_360(root: Path, ids: Sequence[int] = (250, 251, 252, 253), posed: Sequence[int] = (250, 251, 253)) -> Path:
    """Write the four trees; returns the drive's folder. The rectified left camera drives along z."""
    drive = root / "data_2d_raw" / SEQUENCE
    names = [f"{number:010d}.png" for number in ids]
    write_images(drive / "image_00" / "data_rect", drive / "image_01" / "data_rect", names)
    lines = [f"2013-05-28 08:46:{2 + 0.1 * n:012.9f}\n" for n in range(max(ids) + 1)]
    for camera in ("image_00", "image_01"):
        (drive / camera / "timestamps.txt").write_text("".join(lines))
    folder = root / "calibration"
    folder.mkdir()
    text = "calib_time: 01-Jan-2013\n" + row("R_rect_00", R_RECT) + row("R_rect_01", R_RECT)
    for camera, offset_m in (("00", 0.0), ("01", -BASELINE_M)):
        text += row(f"S_rect_{camera}", SIZE[::-1]) + row(f"P_rect_{camera}", projection(offset_m))
    (folder / "perspective.txt").write_text(text)
    T_pose_cam1 = T_POSE_CAM0 @ invert(rectified()) @ shift(BASELINE_M) @ rectified()
    cameras = {"image_00": T_POSE_CAM0, "image_01": T_pose_cam1, "image_02": np.eye(4), "image_03": np.eye(4)}
    (folder / "calib_cam_to_pose.txt").write_text("".join(row(name, T[:3]) for name, T in cameras.items()))
    (folder / "calib_cam_to_velo.txt").write_text(" ".join(map(repr, T_VELO_CAM0[:3].ravel().tolist())) + "\n")
    T_velo_rect = T_VELO_CAM0 @ invert(rectified())
    for number in ids:
        path = root / "data_3d_raw" / SEQUENCE / "velodyne_points" / "data" / f"{number:010d}.bin"
        write_bin(path, transform(T_velo_rect, scene_points()))
    poses, cam0 = "", ""
    for number in posed:
        T_world_rect = placed(number)
        T_world_pose = T_world_rect @ rectified() @ invert(T_POSE_CAM0)
        poses += f"{number} " + " ".join(map(repr, T_world_pose[:3].ravel().tolist())) + "\n"
        cam0 += f"{number} " + " ".join(map(repr, T_world_rect.ravel().tolist())) + "\n"
    folder = root / "data_poses" / SEQUENCE
    folder.mkdir(parents=True)
    (folder / "poses.txt").write_text(poses)
    (folder / "cam0_to_world.txt").write_text(cam0)
    return drive


def shift(right_m: float) -> np.ndarray:
    """(4, 4) of a camera that stands to the right."""
    T = np.eye(4)
    T[0, 3] = right_m
    return T


def placed(number: int) -> np.ndarray:
    """(4, 4) of the rectified left camera in the world at a frame."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", [-90, 0, 30], degrees=True).as_matrix()
    T[:3, 3] = np.array([1000.0, 3800.0, 116.0]) + T[:3, 2] * STEP_M * (number - 250)
    return T
