"""Print cameras, poses and a sweep of a log by av2 as JSON. Runs in an environment of its own (make parsers)."""

import json
import sys
import types
from pathlib import Path

for name in ("cv2", "cv2.typing", "upath"):  # read images and folders in the cloud only
    sys.modules.setdefault(name, types.ModuleType(name))
sys.modules["cv2.typing"].MatLike = object
sys.modules["upath"].UPath = Path
from av2.geometry.camera.pinhole_camera import PinholeCamera  # noqa: E402
from av2.utils.io import read_city_SE3_ego, read_lidar_sweep  # noqa: E402

log = Path(sys.argv[1])
cameras = {}
for folder in (log / "sensors" / "cameras").iterdir():
    camera = PinholeCamera.from_feather(log, folder.name)
    cameras[folder.name] = {
        "K": camera.intrinsics.K.tolist(),
        "size": [camera.height_px, camera.width_px],
        "T_ego_cam": camera.ego_SE3_cam.transform_matrix.tolist(),
    }
poses = {str(time): T.transform_matrix.tolist() for time, T in read_city_SE3_ego(log).items()}
sweeps = {path.stem: read_lidar_sweep(path).tolist() for path in sorted((log / "sensors" / "lidar").iterdir())}
print(json.dumps({"cameras": cameras, "poses": poses, "sweeps": sweeps}))
