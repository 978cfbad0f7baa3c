"""Numbers of the study: Wang et al., "Digging into Depth Priors for Outdoor Neural Radiance Fields", ACM MM 2023.

TABLE_3 is its table 3 (KITTI, the mean of five sequences), TABLE_5 its table 5 (Argoverse, three logs), TABLE_6 its
ablations (one KITTI sequence, MipNeRF-360, sparse views), FEW its section 4.6. SSIM of Instant-NGP is the Gaussian one,
of the others the uniform one; LPIPS is VGG's (docs/nerf-metrics.md).
"""

from collections.abc import Mapping
from typing import NamedTuple


class Row(NamedTuple):
    """Figures of a row, as the study prints them."""

    psnr: float
    """dB"""
    ssim: float
    lpips: float
    rmse: float
    """metres"""
    abs_rel: float


NONE, TRUTH, COMPLETION, STEREO, MONO = "none", "truth", "completion", "stereo", "mono"
ROLES: Mapping[str, str] = {
    NONE: "RGB-Only", TRUTH: "GT Depth", COMPLETION: "Depth Completion", STEREO: "Stereo Depth", MONO: "Mono Depth",
}  # fmt: skip
"""What a prior is in the study -> what the study calls it."""
FIELDS: Mapping[str, str] = {"mip360": "MipNeRF-360", "nerfpp": "NeRF++", "ngp": "Instant-NGP"}

_KITTI = {
    "mip360": {
        NONE: ((21.99, 0.692, 0.437, 3.090, 0.088), (16.93, 0.589, 0.498, 4.662, 0.144)),
        TRUTH: ((21.84, 0.682, 0.451, 0.918, 0.032), (19.14, 0.630, 0.474, 1.044, 0.040)),
        COMPLETION: ((21.51, 0.670, 0.467, 0.818, 0.026), (19.65, 0.631, 0.482, 1.030, 0.032)),
        STEREO: ((21.53, 0.665, 0.469, 1.192, 0.030), (19.80, 0.637, 0.475, 1.246, 0.034)),
        MONO: ((21.48, 0.668, 0.468, 2.161, 0.059), (19.35, 0.625, 0.485, 1.890, 0.058)),
    },
    "nerfpp": {
        NONE: ((20.29, 0.520, 0.585, 48.638, 3.917), (17.60, 0.535, 0.562, 56.253, 4.960)),
        TRUTH: ((20.08, 0.574, 0.563, 1.914, 0.078), (18.90, 0.554, 0.568, 1.882, 0.089)),
        COMPLETION: ((20.15, 0.576, 0.560, 2.618, 0.102), (18.90, 0.553, 0.569, 2.022, 0.094)),
        STEREO: ((20.10, 0.575, 0.560, 1.934, 0.087), (18.85, 0.550, 0.574, 2.061, 0.100)),
        MONO: ((19.87, 0.566, 0.567, 2.256, 0.092), (18.74, 0.548, 0.574, 2.670, 0.110)),
    },
    "ngp": {
        NONE: ((20.51, 0.630, 0.460, 9.575, 0.507), (15.44, 0.499, 0.536, 15.011, 0.793)),
        TRUTH: ((21.31, 0.650, 0.444, 1.571, 0.052), (18.53, 0.586, 0.469, 1.751, 0.060)),
        COMPLETION: ((20.90, 0.632, 0.470, 1.661, 0.050), (18.62, 0.576, 0.492, 1.833, 0.059)),
        STEREO: ((20.93, 0.629, 0.472, 1.830, 0.057), (18.60, 0.574, 0.493, 1.984, 0.064)),
        MONO: ((20.59, 0.617, 0.483, 2.679, 0.085), (18.17, 0.557, 0.502, 2.868, 0.096)),
    },
}
_ARGOVERSE = {
    "mip360": {
        NONE: ((29.35, 0.855, 0.446, 6.113, 0.120), (25.81, 0.829, 0.468, 6.971, 0.139)),
        TRUTH: ((28.78, 0.846, 0.458, 2.251, 0.044), (28.01, 0.840, 0.462, 2.443, 0.048)),
        STEREO: ((28.32, 0.837, 0.470, 4.271, 0.064), (27.72, 0.833, 0.471, 4.310, 0.067)),
        MONO: ((28.58, 0.841, 0.466, 4.601, 0.093), (28.04, 0.836, 0.468, 4.868, 0.093)),
    },
    "ngp": {
        NONE: ((28.07, 0.847, 0.450, 13.478, 0.493), (22.18, 0.816, 0.494, 17.439, 0.593)),
        TRUTH: ((28.92, 0.847, 0.450, 1.804, 0.045), (27.38, 0.834, 0.460, 1.881, 0.048)),
        STEREO: ((28.32, 0.839, 0.460, 5.613, 0.090), (27.10, 0.828, 0.467, 5.843, 0.097)),
        MONO: ((28.31, 0.838, 0.466, 6.083, 0.122), (26.97, 0.829, 0.471, 6.643, 0.132)),
    },
}
Figures = Mapping[tuple[str, str, str], Row]
"""Field, prior's role, views -> a row."""


def _rows(of: Mapping[str, Mapping[str, tuple[tuple[float, ...], tuple[float, ...]]]]) -> Figures:
    return {
        (field, role, views): Row(*row)
        for field, roles in of.items()
        for role, rows in roles.items()
        for views, row in zip(("dense", "sparse"), rows, strict=True)
    }


TABLE_3: Figures = _rows(_KITTI)
TABLE_5: Figures = _rows(_ARGOVERSE)

TABLE_6: Mapping[str, Row] = {
    "none": Row(14.80, 0.475, 0.551, 4.569, 0.153),
    "truth": Row(17.47, 0.542, 0.507, 1.173, 0.045),
    "mono": Row(17.97, 0.542, 0.510, 2.383, 0.073),
    "mono, masked": Row(17.11, 0.535, 0.512, 2.345, 0.076),
    "mono, clip 40": Row(17.60, 0.541, 0.509, 2.470, 0.071),
    "mono, clip 80": Row(18.18, 0.542, 0.510, 2.390, 0.073),
    "stereo": Row(18.87, 0.562, 0.501, 1.349, 0.0405),
    "stereo, confident": Row(18.85, 0.565, 0.495, 1.467, 0.0424),
    "mono, l1": Row(17.91, 0.519, 0.550, 2.543, 0.075),
    "mono, kl": Row(16.55, 0.526, 0.515, 2.487, 0.076),
}
"""The first row of the study's table is by colours alone; its mono rows are of the MSE loss where they say none."""

FEW: Mapping[tuple[str, str], tuple[float, float]] = {
    ("1/8", NONE): (13.1, 0.57),
    ("1/8", MONO): (16.4, 0.52),
    ("1/16", NONE): (11.6, 0.61),
    ("1/16", MONO): (13.0, 0.57),
}
"""Views, prior's role -> PSNR (dB) and LPIPS of Instant-NGP."""
