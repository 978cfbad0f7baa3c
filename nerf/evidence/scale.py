"""Scale: by which factor a prior's depths suit the posed images, and which share of them does not suit.

Patches of a frame are looked for in the frames next to it at their depth times each of some factors. The factor at
which they are most alike on average is the scale: wrong values, be they a third of all, are alike nowhere together.
"""

import numpy as np
import numpy.typing as npt

from nerf.evidence.patches import Pixels, Shot, likeness, textured

Floats = npt.NDArray[np.float32]

FACTORS = np.exp(np.linspace(-np.log(12), np.log(12), 51))
"""From a twelfth to twelve, 10 % apart."""
SAME = 25
"""Which of them is 1."""
PATCHES = 800
"""Of a frame."""
FEWEST = 100
"""Fewer say nothing."""
PLAIN = 0.02
"""How much more alike than at the median factor patches must be at the best one, on average, to tell anything."""
DECISIVE, DECISIVE_NEAR = 0.05, 0.01
"""How much more alike than at the usual scale they must be at another one before it is believed; and at one next to it.
Maps of another place come to 0.048 by chance."""
WITHIN = 1.5
"""A frame's own scale is believed where it is within this factor of the drive's."""
FOUND, BETTER = 0.75, 0.25
"""A patch is found where its best likeness is at least the first, and at another depth where it is better by the second
than at its own."""


def look(shots: list[Shot], depth_m: Floats, seed: int) -> Floats:
    """Look for patches of the first shot in the others.

    Args:
        shots: a frame, and those next to it.
        depth_m: (h, w) its depth, metres; 0 = no value.
        seed: which patches are drawn.

    Returns:
        (n, FACTORS) the likeness of each patch at each factor, the best among the others, in [0, 1].
    """
    pixels = np.flatnonzero(textured(shots[0].grey) & (depth_m > 0) & np.isfinite(depth_m))
    chosen = np.random.default_rng(seed).permutation(pixels)[:PATCHES]
    row, column = np.divmod(chosen, depth_m.shape[1])
    these = Pixels(row, column, depth_m.ravel()[chosen].astype(np.float64))
    if len(shots) == 1:
        return np.zeros((0, len(FACTORS)), np.float32)
    seen = [np.nan_to_num(likeness(shots[0], these, other, FACTORS), nan=0.0) for other in shots[1:]]
    return np.clip(np.max(seen, axis=0, initial=0.0), 0, 1)


def scale_of(alike: Floats, usual: float = 1.0) -> float | None:
    """Return the factor that suits patches (n, FACTORS) best; None: none is better than the others.

    The peak is refined by a parabola through it and its neighbours. It is `usual` where that suits about as well.
    """
    if len(alike) < FEWEST:
        return None
    mean = alike.mean(axis=0)
    peak = int(mean.argmax())
    if mean[peak] - np.median(mean) < PLAIN or not 0 < peak < len(mean) - 1:
        return None
    before, top, after = mean[peak - 1 : peak + 2]
    bend = before - 2 * top + after
    shift = 0.5 * (before - after) / bend if bend < 0 else 0.0
    logs = np.log(FACTORS)
    at_usual = np.interp(np.log(usual), logs, mean)
    needed = DECISIVE_NEAR if abs(logs[peak] - np.log(usual)) < 1.5 * (logs[1] - logs[0]) else DECISIVE
    if top - 0.25 * (before - after) * shift - at_usual < needed:
        return usual
    return float(np.exp(logs[peak] + shift * (logs[1] - logs[0])))


def along(positions: list[int], own: dict[int, float], drive: float) -> Floats:
    """Return the factors (p,) of frames along a drive, from those that some of them have of their own.

    A frame's own is believed where it is within WITHIN of the drive's; what lies between two such frames is between
    their factors.
    """
    near = {position: factor for position, factor in own.items() if drive / WITHIN <= factor <= drive * WITHIN}
    near = near or {positions[0]: drive}
    return np.exp(np.interp(positions, list(near), np.log(list(near.values())))).astype(np.float32)


def wrong_share(alike: Floats) -> float | None:
    """Return which share of the patches (n, FACTORS) that are found are found at another depth; None: too few are."""
    own, best = alike[:, SAME - 1 : SAME + 2].max(axis=1), alike.max(axis=1)
    found = best > FOUND
    return float((own < best - BETTER)[found].mean()) if np.count_nonzero(found) >= FEWEST else None
