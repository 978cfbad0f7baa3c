"""Tiny drives, true to their formats, of one scene whose depth is known: what the readers' tests read.

The scene is a textured wall that leans towards the car: every image row has one depth, so the right view is the left
one with each row shifted by a whole number of pixels, and LiDAR points are the pixels unprojected.
"""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np

from priors import codecs
from priors.geometry import invert, transform
from priors.types import Drive

SIZE = (96, 240)
FX, CX, CY, BASELINE_M = 200.0, 119.5, 47.5, 0.5
K = np.array([[FX, 0, CX], [0, FX, CY], [0, 0, 1.0]])
STEP_M = 1.2
T_CAM0_VELO = np.array([[0, -1, 0, 0.02], [0, 0, -1, -0.06], [1, 0, 0, -0.3], [0, 0, 0, 1.0]])
T_VELO_IMU = np.array([[1, 0, 0, -0.8], [0, 1, 0, 0.3], [0, 0, 1, -0.8], [0, 0, 0, 1.0]])


def drive_folder(street: Path) -> Path:
    """The one KITTI drive's folder in a street's."""
    return next(street.glob("*/*_sync"))


def scene(size: tuple[int, int] = SIZE, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Left image, right image (grey uint8) and the left view's disparity in px."""
    height, width = size
    rng = np.random.default_rng(seed)
    noise = cv2.GaussianBlur(rng.uniform(0, 255, (height, width + 64)).astype(np.float32), (0, 0), 1.2)
    texture = cv2.normalize(noise, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    rows_px = np.linspace(6, 16, height).astype(int)
    right = np.stack([texture[v, d : d + width] for v, d in enumerate(rows_px)])
    return texture[:, :width], right, np.repeat(rows_px[:, None], width, axis=1).astype(np.float32)


def depth_m(disparity_px: np.ndarray) -> np.ndarray:
    """Depth of the scene, metres."""
    return (FX * BASELINE_M / disparity_px).astype(np.float32)


def scene_points(size: tuple[int, int] = SIZE) -> np.ndarray:
    """(n, 3) points of the scene in the left camera's frame, metres: every third pixel."""
    _, _, disparity_px = scene(size)
    v, u = np.mgrid[0 : size[0] : 3, 0 : size[1] : 3]
    z = depth_m(disparity_px)[v, u]
    return np.stack([(u - CX) * z / FX, (v - CY) * z / FX, z], axis=-1).reshape(-1, 3)


def write_images(left: Path, right: Path | None, names: Iterable[str], colour: bool = True) -> None:
    """Write the scene's pair under each name."""
    for number, name in enumerate(names):
        images = scene(seed=number)[:2]
        for folder, image in zip((left, right), images, strict=True):
            if folder is not None:
                codecs.write_image(folder / name, np.repeat(image[..., None], 3, axis=2) if colour else image)


def row(name: str, values: np.ndarray | Sequence[float]) -> str:
    """A line of a KITTI calibration file."""
    return f"{name}: " + " ".join(f"{value:.12e}" for value in np.ravel(values)) + "\n"


def projection(offset_m: float) -> np.ndarray:
    """(3, 4) of a camera that sees points shifted by offset_m along x."""
    return np.hstack([K, K @ np.array([[offset_m], [0], [0]])])


def write_bin(path: Path, xyz_m: np.ndarray) -> None:
    """Write a velodyne file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    np.hstack([xyz_m, np.ones((len(xyz_m), 1))]).astype("<f4").tofile(path)


def write_raw(root: Path, ids: Sequence[int] = range(6), name: str = "2011_09_26_drive_0009_sync") -> Path:
    """A KITTI raw drive that drives straight ahead (yaw 0: east) at STEP_M a frame; returns the drive's folder."""
    date = root / "2011_09_26"
    drive = date / name
    stems = [f"{number:010d}" for number in ids]
    write_images(drive / "image_02" / "data", drive / "image_03" / "data", [f"{stem}.png" for stem in stems])
    text = row("corner_dist", [0.1])
    for camera, offset in (("00", 0.0), ("01", -BASELINE_M), ("02", 0.06), ("03", 0.06 - BASELINE_M)):
        text += row(f"S_rect_{camera}", SIZE[::-1]) + row(f"P_rect_{camera}", projection(offset))
        text += row(f"R_rect_{camera}", np.eye(3))
    (date / "calib_cam_to_cam.txt").write_text("calib_time: 09-Jan-2012 13:57:47\n" + text)
    for file, T in (("calib_velo_to_cam.txt", T_CAM0_VELO), ("calib_imu_to_velo.txt", T_VELO_IMU)):
        (date / file).write_text(row("R", T[:3, :3]) + row("T", T[:3, 3]))
    T_velo_cam2 = invert(T_CAM0_VELO)
    T_velo_cam2[:3, 3] -= T_velo_cam2[:3, :3] @ np.array([0.06, 0, 0])
    for number, stem in zip(ids, stems, strict=True):
        write_bin(drive / "velodyne_points" / "data" / f"{stem}.bin", transform(T_velo_cam2, scene_points()))
        write_oxts(drive / "oxts" / "data" / f"{stem}.txt", number * STEP_M)
    lines = [f"2011-09-26 13:02:{25 + 0.1 * n:012.9f}\n" for n in range(max(ids) + 1)]
    for folder in ("image_02", "image_03"):
        (drive / folder / "timestamps.txt").write_text("".join(lines))
    return drive


def write_oxts(path: Path, east_m: float, latitude: float = 49.0) -> None:
    """Write an oxts file for a place east_m metres east of 8 degrees."""
    path.parent.mkdir(parents=True, exist_ok=True)
    longitude = 8.0 + np.degrees(east_m / (6378137.0 * np.cos(np.radians(latitude))))
    path.write_text(f"{latitude:.15f} {longitude:.15f} 112.8 0 0 0 0 0 12.0" + " 0" * 21 + "\n")


def write_odometry(root: Path, count: int = 5, sequence: str = "06", grey_only: bool = False) -> Path:
    """A KITTI odometry root; grey_only leaves out what the grey zip lacks."""
    folder = root / "sequences" / sequence
    names = [f"{number:06d}.png" for number in range(count)]
    write_images(folder / "image_0", folder / "image_1", names, colour=False)
    calib = row("P0", projection(0)) + row("P1", projection(-BASELINE_M))
    if not grey_only:
        write_images(folder / "image_2", folder / "image_3", names)
        calib += row("P2", projection(0.06)) + row("P3", projection(0.06 - BASELINE_M)) + row("Tr", T_CAM0_VELO[:3])
        (folder / "times.txt").write_text("".join(f"{0.1 * n:.6e}\n" for n in range(count)))
        for name in names:
            points = transform(invert(T_CAM0_VELO), scene_points() - np.array([0.06, 0, 0]))
            write_bin(folder / "velodyne" / name.replace("png", "bin"), points)
    (folder / "calib.txt").write_text(calib)
    write_poses(root / "poses" / f"{sequence}.txt", count)
    return root


def write_poses(path: Path, count: int) -> None:
    """KITTI pose rows that move forward along z by STEP_M a frame."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(f"1 0 0 0 0 1 0 0 0 0 1 {STEP_M * n:.9f}\n" for n in range(count)))


def write_folder(root: Path, ids: Sequence[str] = ("a", "b", "c"), right: bool = True) -> Path:
    """The user's own images: left/, right/, depth/ and calib.json."""
    write_images(root / "left", root / "right" if right else None, [f"{id_}.png" for id_ in ids])
    calib = {"fx": FX, "fy": FX, "cx": CX, "cy": CY, "baseline_m": BASELINE_M}
    (root / "calib.json").write_text(json.dumps(calib))
    for id_ in ids:
        codecs.write_depth_png(root / "depth" / f"{id_}.png", depth_m(scene()[2]))
    write_poses(root / "poses.txt", len(ids))
    return root


def write_as_folder(drive: Drive, root: Path) -> Path:
    """Write a drive as the user's own images: left/, right/, depth/, sparse/, poses.txt and calib.json."""
    frames = [drive[index] for index in range(len(drive))]
    for frame in frames:
        codecs.write_image(root / "left" / f"{frame.id}.png", frame.image())
        codecs.write_image(root / "right" / f"{frame.id}.png", frame.other())
        codecs.write_depth_png(root / "depth" / f"{frame.id}.png", frame.truth().depth_m)
        codecs.write_depth_png(root / "sparse" / f"{frame.id}.png", frame.sparse().depth_m)
    K = frames[0].camera.K
    calib = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2], "baseline_m": frames[0].baseline_m}
    (root / "calib.json").write_text(json.dumps(calib))
    write_pose_lines(root / "poses.txt", [frame.T_world_cam for frame in frames if frame.T_world_cam is not None])
    return root


def write_pose_lines(path: Path, poses: Iterable[np.ndarray]) -> None:
    """Write poses (4, 4), a line each."""
    path.write_text("".join(" ".join(f"{value:.9f}" for value in T[:3].ravel()) + "\n" for T in poses))


def read_pose_rows(path: Path) -> list[np.ndarray]:
    """Read such a file."""
    rows = np.loadtxt(path, ndmin=2).reshape(-1, 3, 4)
    return [np.vstack([row, [0, 0, 0, 1]]) for row in rows]


# Argoverse 1: the focal lengths, centres and places below are those of the API's own test log.
AV_START_NS = 315970000000000000
AV_STEREO = {
    "stereo_front_left": (3660.425411174431, 1246.9202677240673, 1063.4338217897928,
                          [0.49725711847079235, -0.5033139293759432, 0.4991231316939582, -0.5002864639726806],
                          [1.619756836560706, 0.14842013734897835, 1.3648467699127986]),
    "stereo_front_right": (3634.1664215146284, 1260.6433779229542, 1059.5205903709868,
                           [0.5007328527621485, -0.495680186520672, 0.5013368080254209, -0.5022242206170416],
                           [1.6421058178669956, -0.1499718687167596, 1.361891429230726]),
}  # fmt: skip
AV_RECT = {"focal": 3894.034002486376, "cx": 937.5700225830078, "cy": 1063.1990280151367, "Txf_": -1165.2599916429238}
AV_FORWARD_WXYZ = [0.5, -0.5, 0.5, -0.5]  # a camera that looks along the vehicle's x


def av_camera(
    name: str, focal: float, cx: float, cy: float, wxyz: Sequence[float], place_m: Sequence[float], **more: float
) -> dict:
    """An entry of camera_data_."""
    value = {
        "focal_length_x_px_": focal, "focal_length_y_px_": focal, "focal_center_x_px_": cx, "focal_center_y_px_": cy,
        "skew_": 0.0, "distortion_coefficients_": [-0.17, 0.12, -0.03],
        "vehicle_SE3_camera_": {"rotation": {"coefficients": list(wxyz)}, "translation": list(place_m)}, **more,
    }  # fmt: skip
    return {"key": f"image_raw_{name}", "value": value}


def write_ply(path: Path, xyz_m: np.ndarray) -> None:
    """Write a sweep as Argoverse does: binary, with intensity and laser number."""
    path.parent.mkdir(parents=True, exist_ok=True)
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(xyz_m)}\n"
    header += "".join(f"property float {axis}\n" for axis in "xyz")
    header += "property uchar intensity\nproperty ushort laser_number\nend_header\n"
    dtype = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "u1"), ("laser", "<u2")]
    table = np.zeros(len(xyz_m), dtype)
    for axis, column in zip("xyz", np.asarray(xyz_m).T, strict=True):
        table[axis] = column
    path.write_bytes(header.encode() + table.tobytes())


def write_av_pose(log: Path, time_ns: int, x_m: float) -> None:
    """Write a pose x_m ahead of the log's start, in a city frame turned by 90 degrees."""
    folder = log / "poses"
    folder.mkdir(parents=True, exist_ok=True)
    half = np.sqrt(0.5)
    pose = {"rotation": [half, 0.0, 0.0, half], "translation": [3000.0, 1600.0 + x_m, 12.0]}
    (folder / f"city_SE3_egovehicle_{time_ns}.json").write_text(json.dumps(pose))


def write_argoverse_tracking(log: Path, count: int = 2) -> Path:
    """A tracking log: the stereo pair at 5 Hz, one ring camera, sweeps at 10 Hz 30 ms after the images, poses."""
    cameras = [av_camera(name, *values) for name, values in AV_STEREO.items()]
    cameras.append(av_camera("ring_front_center", 1400.0, 960.0, 600.0, AV_FORWARD_WXYZ, [1.6, 0, 1.4]))
    log.mkdir(parents=True, exist_ok=True)
    (log / "vehicle_calibration_info.json").write_text(json.dumps({"camera_data_": cameras}))
    grey = np.tile(np.linspace(0, 255, 2464).astype(np.uint8), (2056, 1))
    for n in range(count):
        time = AV_START_NS + n * 200_000_000
        for name in AV_STEREO:
            codecs.write_image(log / name / f"{name}_{time}.jpg", grey)
        codecs.write_image(log / "ring_front_center" / f"ring_front_center_{time}.jpg", grey[:1200, :1920])
        write_av_pose(log, time, 10.0 * (time - AV_START_NS) * 1e-9)
    for n in range(2 * count):
        time = AV_START_NS + 30_000_000 + n * 100_000_000
        write_ply(log / "lidar" / f"PC_{time}.ply", np.array([[20.0, 1.0, 0.5], [30.0, -1.0, 0.5], [40.0, 0.0, n]]))
        write_av_pose(log, time, 10.0 * (time - AV_START_NS) * 1e-9)
    return log


def write_argoverse_stereo(root: Path, split: str, log: str, refined: bool = True) -> Path:
    """A log of the rectified stereo release, with a disparity map of 20 px where column and row are even."""
    folder = root / "rectified_stereo_images_v1.1" / split / log
    values = (AV_RECT["focal"], AV_RECT["cx"], AV_RECT["cy"])
    cameras = [
        av_camera("stereo_front_left_rect", *values, [1, 0, 0, 0], [0, 0, 0], Txf_=0.0),
        av_camera("stereo_front_right_rect", *values, [1, 0, 0, 0], [0, 0, 0], Txf_=AV_RECT["Txf_"]),
    ]
    if refined:
        cameras.append(av_camera("stereo_front_left_rect_refined", *values, AV_FORWARD_WXYZ, [1.7, 0.1, 1.4]))
    folder.mkdir(parents=True)
    (folder / "vehicle_calibration_stereo_info.json").write_text(json.dumps({"camera_data_": cameras}))
    time = AV_START_NS
    for name in ("stereo_front_left_rect", "stereo_front_right_rect"):
        codecs.write_image(folder / name / f"{name}_{time}.jpg", np.full((2056, 2464, 3), 90, np.uint8))
    disparity_px = np.zeros((2056, 2464), np.float32)
    disparity_px[::2, ::2] = 20.0
    maps = root / "disparity_maps_v1.1" / split / log / "stereo_front_left_rect_disparity"
    codecs.write_depth_png(maps / f"disparity_{time}.png", disparity_px)
    return folder
