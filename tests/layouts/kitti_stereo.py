"""KITTI stereo as its devkits' readmes describe it: two pairs of different sizes and cameras."""

from pathlib import Path

import numpy as np
from factories import BASELINE_M, FX, T_CAM0_VELO, row, scene, write_bin

from priors import codecs
from priors.geometry import invert, transform

SIZES = {"000000": (96, 240), "000001": (80, 200)}
"""Index of a pair -> (height, width); the second has half the focal length."""


def focal_px(index: str) -> float:
    """Focal length of a pair's cameras, px."""
    return FX if index == "000000" else FX / 2


def projection(index: str, offset_m: float) -> np.ndarray:
    """(3, 4) of a pair's camera, which sees points shifted by offset_m along x."""
    height, width = SIZES[index]
    K = np.array([[focal_px(index), 0, (width - 1) / 2], [0, focal_px(index), (height - 1) / 2], [0, 0, 1]])
    return np.hstack([K, K @ [[offset_m], [0], [0]]])


def write_pairs(split: Path, left: str, right: str) -> None:
    """Write the images, a second moment of each, which is not the benchmark's, and truth as disparity."""
    noc, occ = ("disp_noc_0", "disp_occ_0") if left == "image_2" else ("disp_noc", "disp_occ")
    for number, (index, size) in enumerate(SIZES.items()):
        pair, disparity_px = scene(size, number)[:2], scene(size)[2] + np.arange(size[1]) % 32 / 256
        for camera, image in zip((left, right), pair, strict=True):
            pixels = image if camera.startswith("image_0") else np.repeat(image[..., None], 3, axis=2)
            for moment in ("10", "11"):
                codecs.write_image(split / camera / f"{index}_{moment}.png", pixels)
        codecs.write_depth_png(split / occ / f"{index}_10.png", disparity_px)
        seen = np.where(np.arange(size[1]) >= disparity_px, disparity_px, 0)
        codecs.write_depth_png(split / noc / f"{index}_10.png", seen)


def write_2015(root: Path, calibration: str = "calib_cam_to_cam", sweeps: bool = False) -> Path:
    """Write the training split; its calibration is in this folder of it, sweeps beside it. Returns the split."""
    split = root / "training"
    write_pairs(split, "image_2", "image_3")
    for index, size in SIZES.items():
        path = split / calibration / f"{index}.txt"
        path.parent.mkdir(parents=True, exist_ok=True)
        text = "calib_time: 09-Jan-2012 13:57:47\n" + row("R_rect_00", np.eye(3))
        text += row("S_rect_02", size[::-1]) + row("S_rect_03", size[::-1])
        for camera, offset_m in (("02", 0.06), ("03", 0.06 - BASELINE_M)):
            text += row(f"P_rect_{camera}", projection(index, offset_m))
        path.write_text(text)
        if sweeps:
            write_sweep(split, index, size)
        cars = np.zeros(size, np.uint8)
        cars[size[0] // 2 :, : size[1] // 3] = 7
        codecs.write_image(split / "obj_map" / f"{index}_10.png", cars)
    return split


def write_sweep(split: Path, index: str, size: tuple[int, int]) -> None:
    """Write a pair's sweep, every third pixel of the scene, and where it was taken."""
    K, z = projection(index, 0)[:, :3], focal_px(index) * BASELINE_M / scene(size)[2]
    v, u = np.mgrid[: size[0] : 3, : size[1] : 3]
    pixels = np.stack([u.ravel(), v.ravel(), np.ones(u.size)])
    xyz_m = (np.linalg.inv(K) @ pixels * z[v, u].ravel()).T
    T_velo_cam = invert(T_CAM0_VELO)
    T_velo_cam[:3, 3] -= T_velo_cam[:3, :3] @ np.array([0.06, 0, 0])
    write_bin(split / "velodyne" / f"{index}_10.bin", transform(T_velo_cam, xyz_m))
    place = split / "calib_velo_to_cam" / f"{index}.txt"
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text(row("R", T_CAM0_VELO[:3, :3]) + row("T", T_CAM0_VELO[:3, 3]))


def write_2012(root: Path) -> Path:
    """Write the training split with its grey and its colour pair; returns the split."""
    split = root / "data_stereo_flow" / "training"
    write_pairs(split, "image_0", "image_1")
    for number, (index, size) in enumerate(SIZES.items()):
        for camera, image in zip(("colored_0", "colored_1"), scene(size, number)[:2], strict=True):
            codecs.write_image(split / camera / f"{index}_10.png", np.repeat(image[..., None], 3, axis=2))
        path = split / "calib" / f"{index}.txt"
        path.parent.mkdir(parents=True, exist_ok=True)
        offsets_m = (0.0, -BASELINE_M, 0.06, 0.06 - BASELINE_M)
        path.write_text("".join(row(f"P{n}", projection(index, m)) for n, m in enumerate(offsets_m)))
    return split
