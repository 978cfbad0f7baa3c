"""Gaussians as the .ply that viewers open: the public layout of Kerbl et al. (TOG 2023), binary, float32.

    x y z  nx ny nz  f_dc_0..2  f_rest_0..44  opacity  scale_0..2  rot_0..3

f_dc are the harmonics of degree 0 (red, green, blue); f_rest those of degrees 1 to 3, all of red, then green, then
blue. Scales are logarithms of metres, the opacity is a logit, rotations are w x y z. All viewers read degree 3, some
nothing else, so lower degrees are filled with zeros. Places are metres of the scene's frame: readers take no doubles,
and where a drive is far from zero, a comment says what was taken off.
"""

from pathlib import Path

import numpy as np

from eval.files import write_bytes
from nerf.gaussians.types import Gaussians
from priors import origin
from priors.errors import DataError
from priors.origin import Offset

HARMONICS = 16
"""Degrees 0 to 3."""
NAMES = [
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"),
    *(f"f_rest_{number}" for number in range(3 * (HARMONICS - 1))),
    *("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
]
ORIGIN = "comment origin_m"


def write(path: Path, gaussians: Gaussians, origin_m: Offset = origin.NONE) -> None:
    """Write Gaussians, atomically; `origin_m`: where their frame begins in the drive's, metres.

    Raises:
        DataError: the path does not end in .ply.
    """
    if path.suffix.lower() != ".ply":
        raise DataError(f"{path}: expected a name that ends in .ply")
    own = {name: tensor.detach().cpu().numpy() for name, tensor in gaussians.tensors().items()}
    count, given = own["harmonics"].shape[:2]
    whole = np.zeros((count, HARMONICS, 3), np.float32)
    whole[:, :given] = own["harmonics"]
    rest = whole[:, 1:].transpose(0, 2, 1).reshape(count, -1)
    normals = np.zeros((count, 3), np.float32)  # no viewer reads them
    columns = [own["means_m"], normals, whole[:, 0], rest, own["opacities"][:, None], own["log_scales"]]
    table = np.concatenate([*columns, own["rotations"]], axis=1).astype("<f4")
    lines = ["ply", "format binary_little_endian 1.0", "comment metres; scales log, opacity logit, rotation w x y z"]
    lines += [f"{ORIGIN} {' '.join(f'{value:.0f}' for value in origin_m)}"] * (origin_m != origin.NONE)
    lines += [f"element vertex {count}", *(f"property float {name}" for name in NAMES), "end_header"]
    write_bytes(path, "".join(f"{line}\n" for line in lines).encode() + table.tobytes())
