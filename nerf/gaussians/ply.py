"""Gaussians as the .ply that viewers open: the public layout of Kerbl et al. (TOG 2023), binary, float32.

    x y z  nx ny nz  f_dc_0..2  f_rest_0..44  opacity  scale_0..2  rot_0..3

f_dc are the harmonics of degree 0 (red, green, blue); f_rest those of degrees 1 to 3, all of red, then green, then
blue. Scales are logarithms of metres, the opacity is a logit, rotations are w x y z. All viewers read degree 3, some
nothing else, so lower degrees are filled with zeros. Places are metres of the scene's frame: readers take no doubles,
and where a drive is far from zero, a comment says what was taken off.
"""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from eval.files import write_bytes
from nerf import origin
from nerf.origin import Offset
from priors.errors import DataError

Floats = npt.NDArray[np.float32]

HARMONICS = 16
"""Degrees 0 to 3."""
NAMES = [
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"),
    *(f"f_rest_{number}" for number in range(3 * (HARMONICS - 1))),
    *("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
]
ORIGIN = "comment origin_m"


def write(path: Path, splats: dict[str, Floats], origin_m: Offset = origin.NONE) -> None:
    """Write Gaussians, atomically.

    Args:
        path: ends in .ply.
        splats: means_m (n, 3), log_scales (n, 3), rotations (n, 4), opacity (n,) logits, harmonics (n, k, 3).
        origin_m: where their frame begins in the drive's, metres.
    """
    if path.suffix.lower() != ".ply":
        raise DataError(f"{path}: expected a name that ends in .ply")
    count = len(splats["means_m"])
    whole = np.zeros((count, HARMONICS, 3), np.float32)
    whole[:, : splats["harmonics"].shape[1]] = splats["harmonics"]
    rest = whole[:, 1:].transpose(0, 2, 1).reshape(count, -1)
    normals = np.zeros((count, 3), np.float32)  # no viewer reads them
    columns = [splats["means_m"], normals, whole[:, 0], rest]
    columns += [splats["opacity"][:, None], splats["log_scales"], splats["rotations"]]
    table = np.concatenate(columns, axis=1).astype("<f4")
    lines = ["ply", "format binary_little_endian 1.0", "comment metres; scales log, opacity logit, rotation w x y z"]
    lines += [f"{ORIGIN} {' '.join(f'{value:.0f}' for value in origin_m)}"] * (origin_m != origin.NONE)
    lines += [f"element vertex {count}", *(f"property float {name}" for name in NAMES), "end_header"]
    write_bytes(path, "".join(f"{line}\n" for line in lines).encode() + table.tobytes())
