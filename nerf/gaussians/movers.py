"""Movers: pixels of a training frame that the other frames contradict do not count.

What drives or walks stands elsewhere in every frame. Gaussians that all frames train show what most of them agree on,
so a mover's pixels keep a residual where still surfaces lose theirs (RobustNeRF, Sabour et al., CVPR 2023; SpotLess
Splats, Sabour et al., TOG 2025). A colour that stands within REACH pixels in the frame is no residual: edges and fine
texture are never quite in place. What is left is averaged over patches. It is an outlier where it is far above what
nine tenths of the frame have, above a least difference that can be seen and, where there is a prior, nearer than what
is shown: the other frames see through it. Where nothing moves, little is left out.
"""

import cv2
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nerf.gaussians.shot import Shot

LAPS = 1
"""Each training frame is learned from so many times before any of its pixels is left out: soon a mover is learned."""
REACH = 1
"""Pixels to each side."""
PATCH = 5
"""Side of a patch, pixels."""
USUAL, TIMES = 0.9, 4.0
"""An outlier is so many times the residual that a share USUAL of the frame's patches do not reach."""
LEAST = 0.03
"""No smaller mean residual is an outlier; colours are in [0, 1]."""
RIM = 2
"""An outlier's surroundings are left out too, pixels to each side."""
NEARER, MOST = 0.8, 0.5
"""By a prior, most of an outlier's patch is nearer than this share of what is shown: the others see through it."""


def counted(shown: Tensor, depth_m: Tensor, shot: Shot) -> Tensor:
    """Return how much each pixel (h, w) of a frame counts, 0 or 1.

    Args:
        shown: (h, w, 3) what the Gaussians show of the frame.
        depth_m: (h, w) and how far away it is, metres.
        shot: the frame.
    """
    residual = unexplained(shown.detach().cpu().numpy(), shot.rgb.cpu().numpy())
    outlier = residual > max(LEAST, TIMES * float(np.quantile(residual, USUAL)))
    if shot.depth_m is not None:
        before = ((shot.depth_m > 0) & (shot.depth_m < NEARER * depth_m)).float()
        outlier &= cv2.blur(before.cpu().numpy(), (PATCH, PATCH)) > MOST
    around = cv2.dilate(outlier.astype(np.uint8), square(RIM)) > 0
    return torch.from_numpy((~around).astype(np.float32)).to(shown.device)


def unexplained(shown: npt.NDArray[np.float32], truth: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return the patches' mean (h, w) of how far colours (h, w, 3) are from all that stand around in the truth."""
    low, high = cv2.erode(truth, square(REACH)), cv2.dilate(truth, square(REACH))
    off = np.maximum(low - shown, 0) + np.maximum(shown - high, 0)
    return np.asarray(cv2.blur(off.mean(axis=2), (PATCH, PATCH)))


def square(reach: int) -> npt.NDArray[np.uint8]:
    """Return a square of ones that reaches so many pixels to each side of its middle."""
    return np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
