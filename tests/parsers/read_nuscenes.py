"""Print a scene by nuscenes-devkit as JSON. Runs in an environment of its own (make parsers)."""

import json
import sys
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from unittest.mock import MagicMock

ABSENT = ("cv2", "matplotlib", "sklearn", "tqdm", "shapely", "descartes", "pycocotools", "fire", "cachetools")


class Absent(MetaPathFinder, Loader):
    """Stands in for what the devkit draws and scores with."""

    def find_spec(self, name, path=None, target=None):
        return ModuleSpec(name, self, is_package=True) if name.split(".")[0] in ABSENT else None

    def create_module(self, spec):
        module = MagicMock(name=spec.name)
        module.__path__, module.__spec__ = [], spec
        return module

    def exec_module(self, module):
        pass


sys.meta_path.insert(0, Absent())
from nuscenes.nuscenes import NuScenes  # noqa: E402
from nuscenes.utils.data_classes import LidarPointCloud  # noqa: E402

root, version, name = sys.argv[1:]
data = NuScenes(version, root, verbose=False)
scene = next(scene for scene in data.scene if scene["name"] == name)
sample = data.get("sample", scene["first_sample_token"])
found = {}
for channel, token in sample["data"].items():
    records = []
    while token:
        record = data.get("sample_data", token)
        pose = data.get("ego_pose", record["ego_pose_token"])
        sensor = data.get("calibrated_sensor", record["calibrated_sensor_token"])
        points = None
        if channel == "LIDAR_TOP":
            points = LidarPointCloud.from_file(data.get_sample_data_path(token)).points[:3].T.tolist()
        kept = {"file": record["filename"], "time_us": record["timestamp"], "points": points}
        placed = {key: [pose[key], sensor[key]] for key in ("rotation", "translation")}
        records.append({**kept, **placed, "K": sensor["camera_intrinsic"]})
        token = record["next"]
    found[channel] = records
print(json.dumps(found))
