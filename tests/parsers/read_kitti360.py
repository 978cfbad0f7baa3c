"""Print camera poses by kitti360scripts as JSON. Runs in an environment of its own (make parsers)."""

import json
import sys
import types

sys.modules.setdefault("yaml", types.ModuleType("yaml"))  # reads the fish-eyes' files only
from kitti360scripts.devkits.commons.loadCalibration import loadCalibrationRigid  # noqa: E402
from kitti360scripts.helpers.project import CameraPerspective  # noqa: E402

root, sequence = sys.argv[1:]
found = {}
for number in (0, 1):
    camera = CameraPerspective(root, sequence, number)
    found[f"image_0{number}"] = {
        "T_world_cam": {str(int(frame)): T.tolist() for frame, T in camera.cam2world.items()},
        "K": camera.K[:3, :3].tolist(),
        "size": [camera.height, camera.width],
        "R_rect": camera.R_rect.tolist(),
    }
found["T_velo_cam0"] = loadCalibrationRigid(f"{root}/calibration/calib_cam_to_velo.txt").tolist()
print(json.dumps(found))
