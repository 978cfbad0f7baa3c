"""Convex upsampling: every fine pixel is a learned average of its 3x3 coarse neighbours (RAFT, Teed and Deng, 2020)."""

import torch.nn.functional as F
from torch import Tensor


def convex(values: Tensor, weights: Tensor, factor: int) -> Tensor:
    """Upsample maps by a factor.

    Args:
        values: (b, c, h, w) float32; not scaled: a disparity in coarse pixels stays one in coarse pixels.
        weights: (b, 9 * factor^2, h, w) logits; the nine neighbours vary slowest.
        factor: how many times larger the result is.

    Returns:
        (b, c, factor * h, factor * w) float32, each value between the least and the largest of its 3x3 neighbours.
    """
    batch, channels, height, width = values.shape
    share = weights.float().view(batch, 1, 9, factor * factor, height, width).softmax(dim=2)
    padded = F.pad(values.float(), (1, 1, 1, 1), mode="replicate")
    total = None
    for index in range(9):
        row, column = divmod(index, 3)
        neighbour = padded[:, :, row : row + height, column : column + width]
        part = neighbour[:, :, None] * share[:, :, index]
        total = part if total is None else total + part
    assert total is not None
    return F.pixel_shuffle(total.reshape(batch, channels * factor * factor, height, width), factor)
