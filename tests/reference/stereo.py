"""The slow, obvious versions of stereo's kernels."""

import numpy as np
import numpy.typing as npt

Map = npt.NDArray[np.floating]


def link_columns(
    grey: npt.NDArray[np.uint8], disparity_px: Map, slope_px: float, edge_grey: float, edge_px: float
) -> Map:
    """The tie of every pixel to the one below, straight from the formula."""
    links = np.zeros(grey.shape)
    for y in range(grey.shape[0] - 1):
        for x in range(grey.shape[1]):
            step = abs(float(grey[y, x]) - float(grey[y + 1, x])) / edge_grey
            above, below = disparity_px[y, x], disparity_px[y + 1, x]
            if above > 0 and below > 0:
                step += max(abs(float(above) - float(below)) - slope_px, 0) / edge_px
            links[y, x] = np.exp(-step)
    return links


def diffuse_columns(map_: Map, links: Map, strength: float) -> Map:
    """Solve (I + strength L) u = map for every column with a dense matrix."""
    height, width = map_.shape
    solution = np.zeros(map_.shape)
    for x in range(width):
        matrix = np.eye(height)
        for y in range(height - 1):
            tie = strength * links[y, x]
            matrix[y, y] += tie
            matrix[y + 1, y + 1] += tie
            matrix[y, y + 1] -= tie
            matrix[y + 1, y] -= tie
        solution[:, x] = np.linalg.solve(matrix, map_[:, x])
    return solution


def fill_occlusions(
    disparity_px: Map, step_px: float, widest: float, margin_px: float, occluded: float
) -> tuple[Map, Map]:
    """Look at every hole pixel on its own: its nearest matches left and right in the row."""
    filled_px, evidence = disparity_px.copy(), (disparity_px > 0).astype(np.float64)
    for y, x in zip(*np.nonzero(disparity_px <= 0), strict=True):
        left = [k for k in range(x) if disparity_px[y, k] > 0]
        right = [k for k in range(x, disparity_px.shape[1]) if disparity_px[y, k] > 0]
        if left and right:
            rise = disparity_px[y, right[0]] - disparity_px[y, left[-1]]
            if rise > step_px and right[0] - left[-1] - 1 <= widest * rise + margin_px:
                filled_px[y, x], evidence[y, x] = disparity_px[y, left[-1]], occluded
    return filled_px, evidence
