"""A transforms.json as nerfstudio's "Data conventions" describe it, with images, depth and masks."""

import json
from pathlib import Path

import numpy as np
from layouts.posed import BENT, CX, CY, FX, FY, SIZE, Taken, take

from priors import codecs


def write_nerfstudio(root: Path, bent: bool = True, count: int = 3) -> list[Taken]:
    """Write the folder; returns what was taken. Depth is 16-bit, millimetres; masks are black in a corner."""
    views = [take(f"frame_{number + 1:05d}", number, BENT if bent else ()) for number in range(count)]
    frames = []
    for view in views:
        codecs.write_image(root / "images" / f"{view.name}.png", view.image)
        codecs.write_depth_png(root / "depth" / f"{view.name}.png", view.depth_m, "mm")
        mask = np.full(SIZE, 255, np.uint8)
        mask[:20, :30] = 0
        codecs.write_image(root / "masks" / f"{view.name}.png", mask)
        opengl = view.T_world_cam.copy()
        opengl[:, 1:3] *= -1
        names = {"file_path": f"images/{view.name}.png", "depth_file_path": f"depth/{view.name}.png"}
        frames.append({**names, "mask_path": f"masks/{view.name}.png", "transform_matrix": opengl.tolist()})
    top = {"camera_model": "OPENCV", "fl_x": FX, "fl_y": FY, "cx": CX + 0.5, "cy": CY + 0.5, "w": SIZE[1], "h": SIZE[0]}
    top |= dict(zip(("k1", "k2", "p1", "p2"), BENT, strict=True)) if bent else {}
    (root / "transforms.json").write_text(json.dumps({**top, "frames": frames[::-1]}))  # in no order
    return views


def edit(root: Path, **changes: object) -> None:
    """Change entries at the top of the file; None takes one out."""
    path = root / "transforms.json"
    data = {key: value for key, value in {**json.loads(path.read_text()), **changes}.items() if value is not None}
    path.write_text(json.dumps(data))
