"""Maps side by side in one pass over memory; the readable twin is nets/join.py in plain torch."""

from numba import njit, prange

from priors.kernels.floats import Bits


@njit(cache=True, nogil=True, parallel=True)
def put(source: Bits, first: int, out: Bits) -> None:
    """Write a map into channels first, first + 1, ... of out (b, h, w, channels), repeating pixels as often as needed.

    source: (b, h / n, w / n, c).
    """
    batch, height, width, _ = out.shape
    channels, factor = source.shape[3], width // source.shape[2]
    for line in prange(batch * height):
        b, y = line // height, line % height
        given, written = source[b, y // factor], out[b, y]
        for x in range(source.shape[2]):
            for repeat in range(factor):
                pixel = written[factor * x + repeat]
                for k in range(channels):
                    pixel[first + k] = given[x, k]
