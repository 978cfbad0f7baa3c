"""nuScenes as the devkit's schema describes it: two scenes, six cameras and a LiDAR."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from factories import SIZE, K, scene, scene_points
from scipy.spatial.transform import Rotation

from priors import codecs
from priors.geometry import invert, transform

CAMERAS = {"CAM_FRONT": 0, "CAM_FRONT_LEFT": 55, "CAM_FRONT_RIGHT": -55, "CAM_BACK": 180, "CAM_BACK_LEFT": 110,
           "CAM_BACK_RIGHT": -110}  # fmt: skip
"""Channel -> degrees to the left."""
SCENES = ("scene-0061", "scene-0103")
START_US = 1532402927612460
SPEED_M_S = 8.0
T_EGO_LIDAR = np.array([[0, 1, 0, 0.94], [-1, 0, 0, 0.0], [0, 0, 1, 1.84], [0, 0, 0, 1.0]])
OTHER_TABLES = ("category", "attribute", "visibility", "instance", "sample_annotation")
LATE_US = 20_000
"""How much later than the image a sweep is."""


def on_the_car(channel: str) -> np.ndarray:
    """(4, 4) of a camera on the vehicle: x forward, y left, z up."""
    T = np.array([[0, 0, 1, 1.7], [-1, 0, 0, 0.0], [0, -1, 0, 1.5], [0, 0, 0, 1.0]])
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("z", CAMERAS[channel], degrees=True).as_matrix()
    return turn @ T


def placed(time_us: int, number: int = 0) -> np.ndarray:
    """(4, 4) of the vehicle on a scene's map; scenes are a thousand seconds apart."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("z", 40, degrees=True).as_matrix()
    seconds = (time_us - START_US) * 1e-6 - 1000 * number
    T[:3, 3] = [411.3, 1180.9, 0.0] + T[:3, 0] * SPEED_M_S * seconds
    return T


def _pose(T: np.ndarray) -> dict[str, list[float]]:
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
    return {"rotation": [w, x, y, z], "translation": T[:3, 3].tolist()}


def write_nuscenes(root: Path, version: str = "v1.0-mini", scenes: tuple[str, ...] = SCENES) -> Path:
    """Write tables and files: a keyframe and two frames after it, in each scene; returns the data set's folder."""
    tables: dict[str, list[dict[str, Any]]] = {name: [] for name in OTHER_TABLES}
    for name in ("scene", "sample", "sample_data", "ego_pose", "calibrated_sensor", "sensor", "log", "map"):
        tables[name] = []
    places = {channel: on_the_car(channel) for channel in CAMERAS} | {"LIDAR_TOP": T_EGO_LIDAR}
    for channel in places:
        camera = channel.startswith("CAM")
        modality = "camera" if camera else "lidar"
        tables["sensor"].append({"token": f"s-{channel}", "channel": channel, "modality": modality})
        intrinsic = K.tolist() if camera else []
        placed_sensor = {"token": f"c-{channel}", "sensor_token": f"s-{channel}", "camera_intrinsic": intrinsic}
        tables["calibrated_sensor"].append({**placed_sensor, **_pose(places[channel])})
    log = {"logfile": "n015", "vehicle": "n015", "date_captured": "2018-07-24", "location": "singapore-onenorth"}
    tables["log"].append({"token": "log", **log})
    mask = {"log_tokens": ["log"], "category": "semantic_prior", "filename": "maps/mask.png"}
    tables["map"].append({"token": "map", **mask})
    for number, name in enumerate(scenes):
        key = f"k-{name}"
        ends = {"first_sample_token": key, "last_sample_token": key, "nbr_samples": 1}
        tables["scene"].append({"token": f"t-{name}", "name": name, "log_token": "log", "description": "", **ends})
        start = START_US + 1_000_000_000 * number
        tables["sample"].append({"token": key, "scene_token": f"t-{name}", "timestamp": start, "prev": "", "next": ""})
        for channel in places:
            _write_sensor(root, tables, (number, name, channel))
    codecs.write_image(root / "maps" / "mask.png", np.zeros((8, 8), np.uint8))
    folder = root / version
    folder.mkdir(parents=True, exist_ok=True)
    for name, records in tables.items():
        (folder / f"{name}.json").write_text(json.dumps(records))
    return root


def _write_sensor(root: Path, tables: dict[str, list[dict[str, Any]]], where: tuple[int, str, str]) -> None:
    """Write three files of a sensor in a scene, and their records."""
    number, name, channel = where
    for step in range(3):
        image_us = START_US + 1_000_000_000 * number + step * 83_333
        camera = channel.startswith("CAM")
        time_us = image_us if camera else image_us + LATE_US
        kind, suffix = "samples" if step == 0 else "sweeps", "jpg" if camera else "pcd.bin"
        file = f"{kind}/{channel}/n015__{channel}__{time_us}.{suffix}"
        if camera:
            codecs.write_image(root / file, scene(seed=step)[0])
        else:
            wall = transform(placed(image_us, number) @ on_the_car("CAM_FRONT"), scene_points())
            xyz = transform(invert(placed(time_us, number) @ T_EGO_LIDAR), wall)
            (root / file).parent.mkdir(parents=True, exist_ok=True)
            np.hstack([xyz, np.full((len(xyz), 2), 3.0)]).astype("<f4").tofile(root / file)
        token = f"d-{name}-{channel}-{step}"
        tables["ego_pose"].append({"token": token, "timestamp": time_us, **_pose(placed(time_us, number))})
        size = {"height": SIZE[0], "width": SIZE[1]} if camera else {"height": 0, "width": 0}
        tokens = {"sample_token": f"k-{name}", "ego_pose_token": token, "calibrated_sensor_token": f"c-{channel}"}
        following = f"d-{name}-{channel}-{step + 1}" if step < 2 else ""
        links = {"prev": f"d-{name}-{channel}-{step - 1}" if step else "", "next": following}
        more = {"timestamp": time_us, "is_key_frame": step == 0, "fileformat": suffix[-3:], "filename": file}
        tables["sample_data"].append({"token": token, **tokens, **more, **size, **links})
