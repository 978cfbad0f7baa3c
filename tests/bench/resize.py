"""A KITTI raw drive at a smaller size, with the calibration of it: python tests/bench/resize.py DRIVE OUT [--factor 2]

Tables in docs/ that say "half size" are of what this writes. Sweeps and oxts are links to the drive's own.
"""

import argparse
import re
from pathlib import Path

import cv2
import numpy as np


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("drive", type=Path, help="folder of the drive: .../2011_09_26/2011_09_26_drive_0009_sync")
    parser.add_argument("out", type=Path, help="new folder; the drive comes into OUT/<date>/<drive>")
    parser.add_argument("--factor", type=int, default=2, help="whole number that width and height are divided by")
    options = parser.parse_args()
    drive = options.drive.resolve()
    date = options.out / drive.parent.name
    target = date / drive.name
    target.mkdir(parents=True)
    for camera in ("image_02", "image_03"):
        shrink(drive / camera, target / camera, options.factor)
    for name in ("velodyne_points", "oxts"):
        (target / name).symlink_to(drive / name)
    for path in drive.parent.glob("calib_*.txt"):
        text = path.read_text()
        (date / path.name).write_text(calibration(text, options.factor) if "cam_to_cam" in path.name else text)


def shrink(source: Path, target: Path, factor: int) -> None:
    """Write the images of a camera, each pixel the mean of factor x factor; rows and columns that are left over go."""
    (target / "data").mkdir(parents=True)
    for path in sorted((source / "data").iterdir()):
        image = cv2.imread(str(path))
        height, width = (side // factor for side in image.shape[:2])
        whole = image[: height * factor, : width * factor]
        small = cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(target / "data" / f"{path.stem}.png"), small)
    if (source / "timestamps.txt").exists():
        (target / "timestamps.txt").symlink_to(source / "timestamps.txt")


def calibration(text: str, factor: int) -> str:
    """Return calib_cam_to_cam.txt with its rectified sizes and projections divided; the centre of a pixel is (0, 0)."""
    shift = (1 - factor) / (2 * factor)  # (c + 0.5) / factor - 0.5 = c / factor + shift
    scale = np.array([[1 / factor, 0, shift], [0, 1 / factor, shift], [0, 0, 1]])

    def line(match: re.Match[str]) -> str:
        values = np.array(match[2].split(), float)
        values = values // factor if match[1].startswith("S") else (scale @ values.reshape(3, 4)).ravel()
        return f"{match[1]}: " + " ".join(f"{value:.9e}" for value in values)

    return re.sub(r"^([SP]_rect_0\d): (.+)$", line, text, flags=re.MULTILINE)


if __name__ == "__main__":
    main()
