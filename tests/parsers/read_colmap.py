"""Read sparse models by pycolmap and print them as JSON. Runs in an environment of its own (make parsers)."""

import json
import sys

import numpy as np
import pycolmap

GRID = np.array([[10.5, 20.5], [100.5, 50.5], [150.5, 90.5]])  # pixels, the first one's centre is (0.5, 0.5)


def describe(folder: str) -> dict:
    """What pycolmap finds in a model's folder."""
    model, found = pycolmap.Reconstruction(folder), {}
    for image in model.images.values():
        camera = model.cameras[image.camera_id]
        pose = image.cam_from_world() if callable(image.cam_from_world) else image.cam_from_world
        found[image.name] = {
            "T_cam_world": np.vstack([pose.matrix(), [0, 0, 0, 1]]).tolist(),
            "size": [camera.height, camera.width],
            "straight": np.array([camera.cam_from_img(pixel) for pixel in GRID]).reshape(-1, 2).tolist(),
            "points": sorted(int(p.point3D_id) for p in image.points2D if p.has_point3D()),
        }
    points = {str(id_): point.xyz.tolist() for id_, point in model.points3D.items()}
    return {"images": found, "points": points, "grid": GRID.tolist()}


print(json.dumps({folder: describe(folder) for folder in sys.argv[1:]}))
