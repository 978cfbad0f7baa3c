"""KITTI's benchmarks of single frames, as their readmes describe them: objects, and depth's selection."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from factories import BASELINE_M, T_CAM0_VELO, depth_m, row, scene, scene_points, write_bin
from layouts.kitti_stereo import SIZES, focal_px, projection
from scipy.spatial.transform import Rotation

from priors import codecs
from priors.geometry import invert, transform

R0_RECT = Rotation.from_euler("xyz", [0.4, -0.3, 0.2], degrees=True).as_matrix()
DRIVES = ("2011_09_26_drive_0002_sync", "2011_09_29_drive_0026_sync")


def write_object(root: Path, indices: Sequence[str] = ("000000", "000002"), right: bool = True) -> Path:
    """Write the training split; returns it. The first camera is that of the factories, the second another one."""
    split = root / "training"
    for number, (index, like) in enumerate(zip(indices, SIZES, strict=True)):
        size = SIZES[like]
        for camera, image in zip(("image_2", "image_3"), scene(size, number)[:2], strict=True):
            if camera == "image_2" or right:
                codecs.write_image(split / camera / f"{index}.png", np.repeat(image[..., None], 3, axis=2))
        offsets_m = (0.0, -BASELINE_M, 0.06, 0.06 - BASELINE_M)
        text = "".join(row(f"P{n}", projection(like, m)) for n, m in enumerate(offsets_m))
        text += row("R0_rect", R0_RECT) + row("Tr_velo_to_cam", T_CAM0_VELO[:3]) + row("Tr_imu_to_velo", np.eye(4)[:3])
        (split / "calib").mkdir(parents=True, exist_ok=True)
        (split / "calib" / f"{index}.txt").write_text(text + "\n")
        points = scene_points() if number == 0 else np.array([[0.0, 0.0, 9.0], [1.0, 0.5, 12.0]])
        unrectified = (points - [0.06, 0, 0]) @ R0_RECT  # R0_RECT.T of each
        write_bin(split / "velodyne" / f"{index}.bin", transform(invert(T_CAM0_VELO), unrectified))
    return split


def write_selection(root: Path, name: str = "val_selection_cropped") -> Path:
    """Write one of the three folders; returns it. Frames have sizes of their own, which the real ones have not."""
    folder = root / "depth_selection" / name
    for number, (index, size) in enumerate(SIZES.items()):
        anonymous = "anonymous" in name
        stem = f"{number:010d}" if anonymous else f"{DRIVES[number]}_{{}}_{number + 5:010d}_image_0{2 + number}"
        disparity_px = scene(size)[2]
        image, true_m = scene(size, number)[0], depth_m(disparity_px) * focal_px(index) / focal_px("000000")
        codecs.write_image(folder / "image" / f"{stem.format('image')}.png", np.repeat(image[..., None], 3, axis=2))
        K = projection(index, 0.0)[:, :3]
        (folder / "intrinsics").mkdir(exist_ok=True)
        (folder / "intrinsics" / f"{stem.format('image')}.txt").write_text(" ".join(f"{k:.6e}" for k in K.ravel()))
        if name != "test_depth_prediction_anonymous":
            sparse = np.zeros(size, np.float32)
            sparse[::4, ::3] = true_m[::4, ::3]
            codecs.write_depth_png(folder / "velodyne_raw" / f"{stem.format('velodyne_raw')}.png", sparse)
        if not anonymous:
            codecs.write_depth_png(folder / "groundtruth_depth" / f"{stem.format('groundtruth_depth')}.png", true_m)
    return folder
