"""An Argoverse 2 log as the sensor data set's guide describes it: a car that drives along the city's y."""

from pathlib import Path

import numpy as np
from factories import BASELINE_M, FX, SIZE, K, scene, scene_points
from scipy.spatial.transform import Rotation

from priors import codecs
from priors.geometry import invert, transform

START_NS = 315967376859506000
SPEED_M_S = 10.0
T_EGO_CAM = np.array([[0, 0, 1, 1.6], [-1, 0, 0, 0.1], [0, -1, 0, 1.4], [0, 0, 0, 1.0]])
RING = (90, 70)
"""(height, width) of ring_front_center, which stands upright."""


def turned(degrees: float) -> np.ndarray:
    """(4, 4) of a camera that is turned about its own y by so much."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("y", degrees, degrees=True).as_matrix()
    return T


def placed(time_ns: int) -> np.ndarray:
    """(4, 4) of the vehicle in the city."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    T[:3, 3] = [3000.0, 1600.0 + SPEED_M_S * (time_ns - START_NS) * 1e-9, 12.0]
    return T


def write_table(path: Path, **columns: object) -> None:
    """Write a Feather file."""
    import pyarrow
    from pyarrow import feather

    path.parent.mkdir(parents=True, exist_ok=True)
    feather.write_feather(pyarrow.table(columns), path)


def write_places(path: Path, keys: dict[str, list], poses: list[np.ndarray]) -> None:
    """Write poses with the columns before them."""
    quaternions = np.array([Rotation.from_matrix(T[:3, :3]).as_quat() for T in poses])
    names = {"qw": 3, "qx": 0, "qy": 1, "qz": 2}
    columns = {name: quaternions[:, place] for name, place in names.items()}
    columns |= {f"t{axis}_m": np.array([T[n, 3] for T in poses]) for n, axis in enumerate("xyz")}
    write_table(path, **keys, **columns)


def write_log(log: Path, turn_degrees: float = 0.0) -> Path:
    """Write the log: stereo pair at 20 Hz, a ring camera, sweeps at 10 Hz 30 ms after an image, poses at all times.

    turn_degrees: how much the right stereo camera is turned towards the left one; its image is not.
    """
    right = np.eye(4)
    right[0, 3] = BASELINE_M
    cameras = {
        "ring_front_center": T_EGO_CAM,
        "stereo_front_left": T_EGO_CAM,
        "stereo_front_right": T_EGO_CAM @ right @ turned(turn_degrees),
    }
    shapes = {"ring_front_center": RING}
    columns = {"fx_px": [], "fy_px": [], "cx_px": [], "cy_px": [], "height_px": [], "width_px": []}
    for name in cameras:
        height, width = shapes.get(name, SIZE)
        centre = (K[0, 2], K[1, 2]) if name not in shapes else ((width - 1) / 2, (height - 1) / 2)
        for column, value in zip(columns.values(), (FX, FX, *centre, height, width), strict=True):
            column.append(value)
    bent = {name: [-0.25, -0.24, -0.2] for name in ("k1", "k2", "k3")}  # the lens as it was: not to be applied
    write_table(log / "calibration" / "intrinsics.feather", sensor_name=list(cameras), **columns, **bent)
    sensors = {**cameras, "up_lidar": np.eye(4)}
    path = log / "calibration" / "egovehicle_SE3_sensor.feather"
    write_places(path, {"sensor_name": list(sensors)}, list(sensors.values()))
    images = [START_NS + n * 50_000_000 for n in range(4)]
    sweeps = [START_NS + 30_000_000 + n * 100_000_000 for n in (0, 1)]
    for number, time in enumerate(images):
        left_right = scene(seed=number)[:2]
        for name, image in zip(("stereo_front_left", "stereo_front_right"), left_right, strict=True):
            codecs.write_image(log / "sensors" / "cameras" / name / f"{time}.png", image)
        ring = scene(RING, number)[0]
        codecs.write_image(log / "sensors" / "cameras" / "ring_front_center" / f"{time}.jpg", ring)
    for time in sweeps:
        image_time = min(images, key=lambda at: abs(at - time))
        T_then_cam = invert(placed(time)) @ placed(image_time) @ T_EGO_CAM  # the wall stood there at the image's time
        xyz = transform(T_then_cam, scene_points())
        columns = {axis: xyz[:, n].astype(np.float32) for n, axis in enumerate("xyz")}
        count = len(xyz)
        more = {"intensity": np.zeros(count, np.uint8), "laser_number": np.zeros(count, np.uint8)}
        offsets = {"offset_ns": np.zeros(count, np.int32)}
        write_table(log / "sensors" / "lidar" / f"{time}.feather", **columns, **more, **offsets)
    times = sorted({*images, *sweeps} - {images[2]})  # one image lies between two poses
    write_places(log / "city_SE3_egovehicle.feather", {"timestamp_ns": times[::-1]}, [placed(t) for t in times[::-1]])
    return log
