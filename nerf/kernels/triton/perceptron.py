"""MLPs on GPUs: one kernel each way, bfloat16 products, float32 sums, nothing between layers leaves the chip.

A program keeps the weights and walks over tiles of samples. The way back computes the hidden layers again and keeps the
weights' gradients in registers; each program writes its own sums, so that the total does not depend on timing.
Equals nerf/twin/field.py with `half`.
"""

import triton
import triton.language as tl

from nerf.kernels.triton.encode import pack
from nerf.twin.field import LOGIT_MAX

_LIMIT = tl.constexpr(LOGIT_MAX)


@triton.jit
def _matrix(  # type: ignore[no-untyped-def]
    source, rows, columns, stride, step: tl.constexpr, ROWS: tl.constexpr, COLUMNS: tl.constexpr
):
    """Read every step-th number of (rows, columns) as bfloat16, zeros around."""
    row, column = tl.arange(0, ROWS)[:, None], tl.arange(0, COLUMNS)[None, :]
    inside = (row < rows) & (column < columns)
    return tl.load(source + row * stride + column * step, mask=inside, other=0.0).to(tl.bfloat16)


@triton.jit
def _put(  # type: ignore[no-untyped-def]
    target, tile, rows, columns, stride, step: tl.constexpr, ROWS: tl.constexpr, COLUMNS: tl.constexpr
):
    """Undo `_matrix`."""
    row, column = tl.arange(0, ROWS)[:, None], tl.arange(0, COLUMNS)[None, :]
    tl.store(target + row * stride + column * step, tile, mask=(row < rows) & (column < columns))


@triton.jit
def _features(words, sample, count, LEVELS: tl.constexpr):  # type: ignore[no-untyped-def]
    """Return the first and the second feature of 16 levels, bfloat16 (TILE, 16) each."""
    level = tl.arange(0, 16)[None, :]
    word = tl.load(words + level * count + sample[:, None], mask=level < LEVELS, other=0)
    low = (word << 16).to(tl.float32, bitcast=True).to(tl.bfloat16)
    return low, (word & -65536).to(tl.float32, bitcast=True).to(tl.bfloat16)


@triton.jit
def _layer(x, weights):  # type: ignore[no-untyped-def]
    return tl.dot(x, tl.trans(weights))


@triton.jit
def _hidden(x):  # type: ignore[no-untyped-def]
    return tl.maximum(x, 0.0).to(tl.bfloat16)


@triton.jit
def _pass(hidden, gradient):  # type: ignore[no-untyped-def]
    """Return the gradient of what came before `_hidden`."""
    return tl.where(hidden.to(tl.float32) > 0, gradient, 0.0).to(tl.bfloat16)


@triton.jit
def _first(tile):  # type: ignore[no-untyped-def]
    """Return the first column, exactly."""
    return tl.sum(tl.where(tl.arange(0, 16)[None, :] == 0, tile, 0.0), axis=1)


@triton.jit
def _seen(harmonics, ray, sample):  # type: ignore[no-untyped-def]
    """Return the harmonics of the samples' rays, bfloat16 (TILE, 16); any ray's in the padding."""
    row = tl.maximum(tl.load(ray + sample), 0)
    return tl.load(harmonics + row[:, None] * 16 + tl.arange(0, 16)[None, :]).to(tl.bfloat16)


@triton.jit
def forward(  # type: ignore[no-untyped-def]
    words, harmonics, ray, density0, density1, colour0, colour1, colour2, initial, sigma, rgb, count,
    LEVELS: tl.constexpr, NEURONS: tl.constexpr, WIDTH: tl.constexpr, TILE: tl.constexpr, COLOUR: tl.constexpr,
):  # fmt: skip
    """Fill sigma (count,) and, if COLOUR, rgb (count, 3). WIDTH is NEURONS, filled up to a power of two."""
    w_low = _matrix(density0, NEURONS, LEVELS, 2 * LEVELS, 2, WIDTH, 16)
    w_high = _matrix(density0 + 1, NEURONS, LEVELS, 2 * LEVELS, 2, WIDTH, 16)
    w_geometry = _matrix(density1, 16, NEURONS, NEURONS, 1, 16, WIDTH)
    if COLOUR:
        w_seen = _matrix(colour0, NEURONS, 16, 32, 1, WIDTH, 16)
        w_shape = _matrix(colour0 + 16, NEURONS, 16, 32, 1, WIDTH, 16)
        w_middle = _matrix(colour1, NEURONS, NEURONS, NEURONS, 1, WIDTH, WIDTH)
        w_out = _matrix(colour2, 3, NEURONS, NEURONS, 1, 16, WIDTH)
    for tile in range(tl.program_id(0), count // TILE, tl.num_programs(0)):
        sample = tile * TILE + tl.arange(0, TILE)
        low, high = _features(words, sample, count, LEVELS)
        geometry = _layer(_hidden(_layer(low, w_low) + _layer(high, w_high)), w_geometry)
        tl.store(sigma + sample, initial * tl.exp(tl.minimum(_first(geometry), _LIMIT)))
        if COLOUR:
            seen, shape = _seen(harmonics, ray, sample), geometry.to(tl.bfloat16)
            hidden = _hidden(_layer(seen, w_seen) + _layer(shape, w_shape))
            out = tl.sigmoid(_layer(_hidden(_layer(hidden, w_middle)), w_out))
            channel = tl.arange(0, 16)[None, :]
            tl.store(rgb + 3 * sample[:, None] + channel, out, mask=channel < 3)


@triton.jit
def backward(  # type: ignore[no-untyped-def]
    words, harmonics, ray, density0, density1, colour0, colour1, colour2, initial, d_sigma, d_rgb, d_words, sums, count,
    LEVELS: tl.constexpr, NEURONS: tl.constexpr, WIDTH: tl.constexpr, TILE: tl.constexpr, COLOUR: tl.constexpr,
):  # fmt: skip
    """Fill the features' gradient d_words (levels, count) and sums (programs, numbers of all layers in a row).

    Without COLOUR the sums hold the first two layers.
    """
    w_low = _matrix(density0, NEURONS, LEVELS, 2 * LEVELS, 2, WIDTH, 16)
    w_high = _matrix(density0 + 1, NEURONS, LEVELS, 2 * LEVELS, 2, WIDTH, 16)
    w_geometry = _matrix(density1, 16, NEURONS, NEURONS, 1, 16, WIDTH)
    d_w_low = tl.zeros([WIDTH, 16], tl.float32)
    d_w_high = tl.zeros([WIDTH, 16], tl.float32)
    d_w_geometry = tl.zeros([16, WIDTH], tl.float32)
    if COLOUR:
        w_seen = _matrix(colour0, NEURONS, 16, 32, 1, WIDTH, 16)
        w_shape = _matrix(colour0 + 16, NEURONS, 16, 32, 1, WIDTH, 16)
        w_middle = _matrix(colour1, NEURONS, NEURONS, NEURONS, 1, WIDTH, WIDTH)
        w_out = _matrix(colour2, 3, NEURONS, NEURONS, 1, 16, WIDTH)
        d_w_seen = tl.zeros([WIDTH, 16], tl.float32)
        d_w_shape = tl.zeros([WIDTH, 16], tl.float32)
        d_w_middle = tl.zeros([WIDTH, WIDTH], tl.float32)
        d_w_out = tl.zeros([16, WIDTH], tl.float32)
    for tile in range(tl.program_id(0), count // TILE, tl.num_programs(0)):
        sample = tile * TILE + tl.arange(0, TILE)
        column = tl.arange(0, 16)[None, :]
        low, high = _features(words, sample, count, LEVELS)
        hidden = _hidden(_layer(low, w_low) + _layer(high, w_high))
        geometry = _layer(hidden, w_geometry)
        # The gradient passes the density's limit.
        found = initial * tl.exp(tl.minimum(_first(geometry), _LIMIT))
        d_geometry = tl.where(column == 0, (tl.load(d_sigma + sample) * found)[:, None], 0.0)
        if COLOUR:
            seen, shape = _seen(harmonics, ray, sample), geometry.to(tl.bfloat16)
            one = _hidden(_layer(seen, w_seen) + _layer(shape, w_shape))
            two = _hidden(_layer(one, w_middle))
            out = tl.sigmoid(_layer(two, w_out))
            d_out = tl.load(d_rgb + 3 * sample[:, None] + column, mask=column < 3, other=0.0)
            d_out = (d_out * out * (1 - out)).to(tl.bfloat16)
            d_w_out += tl.dot(tl.trans(d_out), two)
            d_two = _pass(two, tl.dot(d_out, w_out))
            d_w_middle += tl.dot(tl.trans(d_two), one)
            d_one = _pass(one, tl.dot(d_two, w_middle))
            d_w_seen += tl.dot(tl.trans(d_one), seen)
            d_w_shape += tl.dot(tl.trans(d_one), shape)
            d_geometry += tl.dot(d_one, w_shape)
        d_geometry = d_geometry.to(tl.bfloat16)
        d_w_geometry += tl.dot(tl.trans(d_geometry), hidden)
        d_hidden = _pass(hidden, tl.dot(d_geometry, w_geometry))
        d_w_low += tl.dot(tl.trans(d_hidden), low)
        d_w_high += tl.dot(tl.trans(d_hidden), high)
        word = pack(tl.dot(d_hidden, w_low), tl.dot(d_hidden, w_high))
        tl.store(d_words + column * count + sample[:, None], word, mask=column < LEVELS)

    density_numbers: tl.constexpr = NEURONS * (2 * LEVELS + 16)
    colour_numbers: tl.constexpr = NEURONS * (32 + NEURONS + 3) if COLOUR else 0
    own = sums + tl.program_id(0) * (density_numbers + colour_numbers)
    _put(own, d_w_low, NEURONS, LEVELS, 2 * LEVELS, 2, WIDTH, 16)
    _put(own + 1, d_w_high, NEURONS, LEVELS, 2 * LEVELS, 2, WIDTH, 16)
    _put(own + 2 * LEVELS * NEURONS, d_w_geometry, 16, NEURONS, NEURONS, 1, 16, WIDTH)
    if COLOUR:
        own += density_numbers
        _put(own, d_w_seen, NEURONS, 16, 32, 1, WIDTH, 16)
        _put(own + 16, d_w_shape, NEURONS, 16, 32, 1, WIDTH, 16)
        _put(own + 32 * NEURONS, d_w_middle, NEURONS, NEURONS, NEURONS, 1, WIDTH, WIDTH)
        _put(own + (32 + NEURONS) * NEURONS, d_w_out, 3, NEURONS, NEURONS, 1, 16, WIDTH)
