"""Read exports by pycolmap and plyfile and print them as JSON. Runs in an environment of its own (make parsers).

read_exports.py MODEL POINTS.ply
"""

import json
import sys

import numpy as np
import pycolmap
from plyfile import PlyData


def describe_model(folder: str) -> dict:
    """What pycolmap finds in a model's folder, and where it projects each image's points."""
    model, found = pycolmap.Reconstruction(folder), {}
    for image in model.images.values():
        pose = image.cam_from_world() if callable(image.cam_from_world) else image.cam_from_world
        seen = [point for point in image.points2D if point.has_point3D()]
        projected = [image.project_point(model.points3D[point.point3D_id].xyz) for point in seen]
        errors = np.linalg.norm(np.array(projected) - [point.xy for point in seen], axis=1)
        single = [len(model.points3D[point.point3D_id].track.elements) == 1 for point in seen]
        found[image.name] = {
            "T_cam_world": np.vstack([pose.matrix(), [0, 0, 0, 1]]).tolist(),
            "K": model.cameras[image.camera_id].calibration_matrix().tolist(),
            "error_px_of_single": float(errors[single].max()) if any(single) else 0.0,
        }
    lengths = [len(point.track.elements) for point in model.points3D.values()]
    return {"images": found, "points": len(lengths), "longest": max(lengths)}


def describe_points(path: str) -> dict:
    """What plyfile finds in a file of points."""
    vertices = PlyData.read(path)["vertex"]
    kinds = {each.name: each.val_dtype for each in vertices.properties}
    return {"kinds": kinds, "count": len(vertices), "first": [float(vertices[name][0]) for name in kinds]}


print(json.dumps({"model": describe_model(sys.argv[1]), "points": describe_points(sys.argv[2])}))
