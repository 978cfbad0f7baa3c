"""Votes between maps as loops over whole arrays: every value is projected, looked up and counted by itself."""

import numpy as np


def vote(inverse, voter, rules):
    """The votes (2, h, w) that another frame casts on a map's values: those that agree, and those against."""
    ballot = np.zeros((2, *inverse.shape))
    for row, column in np.argwhere(inverse > 0):
        at, expected = landed(voter.there, row, column, inverse[row, column])
        if inside(at, voter.inverse) and voter.inverse[at] > 0:
            verdict, weight = compared(voter.inverse[at], expected, rules, rules.hidden)
            ballot[verdict, row, column] += weight * voter.trust[at]
    for row, column in np.argwhere(voter.inverse > 0):
        at, expected = landed(voter.here, row, column, voter.inverse[row, column])
        if inside(at, inverse) and inverse[at] > 0:
            verdict, weight = compared(inverse[at], expected, rules, rules.hides)
            ballot[verdict][at] += weight * voter.trust[row, column]
    return ballot


def compared(found, expected, rules, nearer):
    """0 or 1, agreed or against, and the weight of it: `nearer` where what is found is nearer than expected."""
    ratio = max(found / expected, expected / found)
    if ratio <= rules.agree:
        return 0, 1.0
    if ratio <= rules.against:
        return 1, 0.0
    return 1, nearer if found > expected else 1.0


def landed(M, row, column, inverse):
    """The pixel, row first, on which a place lands, and its inverse depth there; None behind the camera."""
    q = M[:, :3] @ (column, row, 1.0) + M[:, 3] * inverse
    if q[2] <= 1e-9:
        return None, -1.0
    return (int(np.floor(q[1] / q[2] + 0.5)), int(np.floor(q[0] / q[2] + 0.5))), inverse / q[2]


def inside(at, values):
    """Whether a pixel lies in a map."""
    return at is not None and 0 <= at[0] < values.shape[0] and 0 <= at[1] < values.shape[1]


def pool(inverse, ballot, rules, stride):
    """The votes that values share with those around them that are about as far."""
    out, height, width = np.zeros_like(ballot), *inverse.shape
    steps = range(-rules.half_px, rules.half_px + 1, stride)
    for row, column in np.argwhere(inverse > 0):
        for y, x in ((row + dy, column + dx) for dy in steps for dx in steps):
            if 0 <= y < height and 0 <= x < width and inverse[y, x] > 0:
                ratio = inverse[y, x] / inverse[row, column]
                if max(ratio, 1 / ratio) <= rules.layer:
                    out[:, row, column] += ballot[:, y, x]
    return out
