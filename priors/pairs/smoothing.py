"""Smooth a disparity map and fill its holes in one go, stopping where the image or the disparity has an edge."""

import cv2
import numpy as np

from priors.types import FloatMap, Image

SMOOTHING_ROUNDS = 2
STRENGTH = 30.0  # a value reaches about sqrt(30) pixels over even ground
EDGE_GREY, EDGE_PX = 8.0, 1.0  # steps that weaken the tie of two neighbours to 1/e
SLOPE_PX = 1.0  # a disparity step that is no edge: roads slant from row to row
OCCLUSION_STEP_PX, WIDEST, MARGIN_PX = 1.5, 1.5, 3.0  # a larger step, and a hole not much wider than it: an occlusion
OCCLUDED = 0.05  # evidence of the background next to an occlusion
VOID = 1e-12  # evidence everywhere for the background: decides where no match is near
BACKGROUND_QUANTILE = 0.05


def diffuse(disparity_px: FloatMap, grey: Image) -> tuple[FloatMap, FloatMap]:
    """Spread matched disparities (height, width), 0 = none, over the image (height, width) uint8.

    Fast global smoothing (Min et al., "Fast Global Image Smoothing Based on Weighted Least Squares", 2014) of the
    values and of their presence; the quotient of the two has a value everywhere. An occlusion takes the value on its
    background side, with little evidence; far from any match (some 150 px) the value becomes the scene's background.

    Returns:
        disparity_px (height, width), above 0 everywhere unless the input has no value at all, and the evidence
        (height, width) in [0, 1]: the share of matches in what was averaged.
    """
    from priors.kernels.diffusion import diffuse_columns, link_columns
    from priors.kernels.occlusion import fill_occlusions

    matched = disparity_px > 0
    if not matched.any():
        return np.zeros_like(disparity_px), np.zeros_like(disparity_px)
    background_px = float(np.quantile(disparity_px[matched][::7], BACKGROUND_QUANTILE))
    links = link_columns(grey, disparity_px, SLOPE_PX, EDGE_GREY, EDGE_PX)
    grey_T = np.ascontiguousarray(grey.T)
    links_T = link_columns(grey_T, _transpose(disparity_px), SLOPE_PX, EDGE_GREY, EDGE_PX)
    filled_px, evidence = fill_occlusions(disparity_px, OCCLUSION_STEP_PX, WIDEST, MARGIN_PX, OCCLUDED)
    total_px = filled_px * evidence + np.float32(VOID * background_px)
    evidence += np.float32(VOID)
    for strength in 1.5 * STRENGTH * 4.0 ** np.arange(SMOOTHING_ROUNDS - 1, -1, -1) / (4.0**SMOOTHING_ROUNDS - 1):
        total_px, evidence = _transpose(total_px), _transpose(evidence)
        diffuse_columns(total_px, evidence, links_T, strength)
        total_px, evidence = _transpose(total_px), _transpose(evidence)
        diffuse_columns(total_px, evidence, links, strength)
    return total_px / evidence, np.minimum(evidence, np.float32(1))


def _transpose(map_: FloatMap) -> FloatMap:
    return np.asarray(cv2.transpose(map_))
