"""Volume rendering and its losses on GPUs: a ray a thread, near to far and back. Equals nerf/twin/render.py.

Neighbouring threads walk neighbouring rays; a ray's samples share cache lines from step to step. All sums are float32.
"""

import triton
import triton.language as tl

from nerf.types import INTERLEVEL_SOFT, LEAST_MASS, LEAST_OPACITY, SIGHT_DEVIATIONS

_LEAST_OPACITY, _LEAST_MASS = tl.constexpr(LEAST_OPACITY), tl.constexpr(LEAST_MASS)
_SIGHT_DEVIATIONS, _INTERLEVEL_SOFT = tl.constexpr(SIGHT_DEVIATIONS), tl.constexpr(INTERLEVEL_SOFT)


@triton.jit
def _rays(offsets, count, RAYS: tl.constexpr):  # type: ignore[no-untyped-def]
    """Return this program's rays, which of them exist, their first samples and ends, and the most samples of any."""
    ray = tl.program_id(0) * RAYS + tl.arange(0, RAYS)
    real = ray < count
    first = tl.load(offsets + ray, mask=real, other=0)
    last = tl.load(offsets + ray + 1, mask=real, other=0)
    return ray, real, first, last, tl.max(last - first, axis=0).to(tl.int32)


@triton.jit
def _stopped(tau):  # type: ignore[no-untyped-def]
    """Return 1 - exp(-tau), tau >= 0, relative error below 1e-6: its series where the difference would cancel."""
    series = tau * (1 - tau / 2 * (1 - tau / 3 * (1 - tau / 4 * (1 - tau / 5 * (1 - tau / 6 * (1 - tau / 7))))))
    return tl.where(tau < 0.25, series, 1 - tl.exp(-tau))


@triton.jit
def _mass(t, half, centre, deviation):  # type: ignore[no-untyped-def]
    """Return a normal distribution's mass within half of t; doubles, because far from the centre it is a difference."""
    root = 0.7071067811865476 / deviation.to(tl.float64)
    away = t.to(tl.float64) - centre
    return (0.5 * (tl.math.erf((away + half) * root) - tl.math.erf((away - half) * root))).to(tl.float32)


@triton.jit
def forward(  # type: ignore[no-untyped-def]
    offsets, sigma, colour, t, dt_m, sky, count, rgb, depth_m, median_m, transmittance, weights,
    FLOOR: tl.constexpr, RAYS: tl.constexpr,
):  # fmt: skip
    """Fill rgb (count, 3), depth_m, median_m, transmittance (count,) and the weights of the rays' samples."""
    ray, real, first, last, most = _rays(offsets, count, RAYS)
    optical = tl.zeros([RAYS], tl.float32)
    through = tl.full([RAYS], 1.0, tl.float32)
    red, green, blue, moment, middle = optical, optical, optical, optical, optical
    for k in range(most):
        i = first + k
        here = i < last
        tau = tl.load(sigma + i, mask=here, other=0.0) * tl.load(dt_m + i, mask=here, other=0.0)
        place = tl.load(t + i, mask=here, other=0.0)
        w = through * _stopped(tau)
        optical += tau
        after = tl.exp(-optical)
        middle = tl.where((through > 0.5) & (after <= 0.5), place, middle)
        tl.store(weights + i, w, mask=here)
        red += w * tl.load(colour + 3 * i, mask=here, other=0.0)
        green += w * tl.load(colour + 3 * i + 1, mask=here, other=0.0)
        blue += w * tl.load(colour + 3 * i + 2, mask=here, other=0.0)
        moment += w * place
        through = after
    tl.store(rgb + 3 * ray, red + through * tl.load(sky + 3 * ray, mask=real, other=0.0), mask=real)
    tl.store(rgb + 3 * ray + 1, green + through * tl.load(sky + 3 * ray + 1, mask=real, other=0.0), mask=real)
    tl.store(rgb + 3 * ray + 2, blue + through * tl.load(sky + 3 * ray + 2, mask=real, other=0.0), mask=real)
    tl.store(depth_m + ray, moment / tl.maximum(_stopped(optical), FLOOR), mask=real)
    tl.store(median_m + ray, middle, mask=real)
    tl.store(transmittance + ray, through, mask=real)


@triton.jit
def backward(  # type: ignore[no-untyped-def]
    offsets, sigma, colour, t, dt_m, sky, depth_m, transmittance, weights,
    d_rgb, d_depth, d_transmittance, d_weights, d_tau, count, d_sigma, d_colour, d_sky,
    FLOOR: tl.constexpr, RAYS: tl.constexpr,
):  # fmt: skip
    """Fill d_sigma and d_colour of the rays' samples, and d_sky (count, 3), from nerf.types.Gradients."""
    ray, real, first, last, most = _rays(offsets, count, RAYS)
    end = tl.load(transmittance + ray, mask=real, other=1.0)
    opacity = 1 - end
    d_red = tl.load(d_rgb + 3 * ray, mask=real, other=0.0)
    d_green = tl.load(d_rgb + 3 * ray + 1, mask=real, other=0.0)
    d_blue = tl.load(d_rgb + 3 * ray + 2, mask=real, other=0.0)
    d_end = tl.load(d_transmittance + ray, mask=real, other=0.0)
    d_end += d_red * tl.load(sky + 3 * ray, mask=real, other=0.0)
    d_end += d_green * tl.load(sky + 3 * ray + 1, mask=real, other=0.0)
    d_end += d_blue * tl.load(sky + 3 * ray + 2, mask=real, other=0.0)
    tl.store(d_sky + 3 * ray, d_red * end, mask=real)
    tl.store(d_sky + 3 * ray + 1, d_green * end, mask=real)
    tl.store(d_sky + 3 * ray + 2, d_blue * end, mask=real)
    # depth = sum(w t) / max(opacity, floor), and opacity = sum(w)
    per_moment = tl.load(d_depth + ray, mask=real, other=0.0) / tl.maximum(opacity, FLOOR)
    per_opacity = tl.where(opacity > FLOOR, -per_moment * tl.load(depth_m + ray, mask=real, other=0.0), 0.0)
    # Going back, the light left cannot be had by subtraction in float32: d_sigma holds it until then.
    optical = tl.zeros([RAYS], tl.float32)
    for k in range(most):
        i = first + k
        here = i < last
        optical += tl.load(sigma + i, mask=here, other=0.0) * tl.load(dt_m + i, mask=here, other=0.0)
        tl.store(d_sigma + i, tl.exp(-optical), mask=here)
    behind = d_end * end
    for k in range(most):
        i = last - 1 - k
        here = i >= first
        w = tl.load(weights + i, mask=here, other=0.0)
        d_w = tl.load(d_weights + i, mask=here, other=0.0) + per_opacity
        d_w += per_moment * tl.load(t + i, mask=here, other=0.0)
        d_w += d_red * tl.load(colour + 3 * i, mask=here, other=0.0)
        d_w += d_green * tl.load(colour + 3 * i + 1, mask=here, other=0.0)
        d_w += d_blue * tl.load(colour + 3 * i + 2, mask=here, other=0.0)
        tl.store(d_colour + 3 * i, d_red * w, mask=here)
        tl.store(d_colour + 3 * i + 1, d_green * w, mask=here)
        tl.store(d_colour + 3 * i + 2, d_blue * w, mask=here)
        # w = T (1 - exp(-tau)): its own tau adds T exp(-tau), every tau before takes w away
        after = tl.load(d_sigma + i, mask=here, other=0.0)
        own = d_w * after - behind + tl.load(d_tau + i, mask=here, other=0.0)
        tl.store(d_sigma + i, own * tl.load(dt_m + i, mask=here, other=0.0), mask=here)
        behind += d_w * w


@triton.jit
def distortion(offsets, weights, s0, s1, scale, count, loss, d_weights, RAYS: tl.constexpr):  # type: ignore[no-untyped-def]
    """Fill mip-NeRF 360's distortion of each ray, loss (count,), add its gradient times scale to d_weights.

    sum_ij w_i w_j |m_i - m_j| + sum_i w_i^2 (s1_i - s0_i) / 3, intervals in order (Barron et al., CVPR 2022, eq. 15).
    """
    ray, real, first, last, most = _rays(offsets, count, RAYS)
    pull = tl.load(scale + ray, mask=real, other=0.0)
    after = tl.zeros([RAYS], tl.float32)
    after_moment, before, before_moment, found = after, after, after, after
    for k in range(most):
        i = first + k
        here = i < last
        w = tl.load(weights + i, mask=here, other=0.0)
        after += w
        after_moment += w * 0.5 * (tl.load(s0 + i, mask=here, other=0.0) + tl.load(s1 + i, mask=here, other=0.0))
    for k in range(most):
        i = first + k
        here = i < last
        w = tl.load(weights + i, mask=here, other=0.0)
        start, stop = tl.load(s0 + i, mask=here, other=0.0), tl.load(s1 + i, mask=here, other=0.0)
        middle, width = 0.5 * (start + stop), stop - start
        after -= w
        after_moment -= w * middle
        apart = middle * (before - after) - before_moment + after_moment
        found += w * apart + w * w * width / 3
        given = tl.load(d_weights + i, mask=here, other=0.0)
        tl.store(d_weights + i, given + pull * 2 * (apart + w * width / 3), mask=here)
        before += w
        before_moment += w * middle
    tl.store(loss + ray, found, mask=real)


@triton.jit
def kl(  # type: ignore[no-untyped-def]
    offsets, sigma, dt_m, t, norms, prior_m, deviation_m, scale, count, loss, d_tau, RAYS: tl.constexpr
):
    """Fill loss (count,) with -sum q log w, add its gradient times scale to d_tau; see nerf.losses."""
    ray, real, first, last, most = _rays(offsets, count, RAYS)
    norm, centre = tl.load(norms + ray, mask=real, other=1.0), tl.load(prior_m + ray, mask=real, other=0.0)
    deviation = tl.load(deviation_m + ray, mask=real, other=1.0)
    total = tl.zeros([RAYS], tl.float32)
    for k in range(most):
        i = first + k
        here = i < last
        half = 0.5 * tl.load(dt_m + i, mask=here, other=0.0) / norm
        total += _mass(tl.load(t + i, mask=here, other=0.0), half, centre, deviation)
    usable = (centre > 0) & (total >= _LEAST_MASS)
    share = tl.where(usable, 1 / tl.where(usable, total, 1.0), 0.0)
    optical = tl.zeros([RAYS], tl.float32)
    found = optical
    for k in range(most):
        i = first + k
        here = i < last
        dt = tl.load(dt_m + i, mask=here, other=0.0)
        q = share * _mass(tl.load(t + i, mask=here, other=0.0), 0.5 * dt / norm, centre, deviation)
        tau = tl.load(sigma + i, mask=here, other=0.0) * dt
        found -= tl.where(here, q * (tl.log(tl.maximum(_stopped(tau), _LEAST_OPACITY)) - optical), 0.0)
        optical += tau
    tl.store(loss + ray, found, mask=real)
    pull = tl.load(scale + ray, mask=real, other=0.0)
    behind = tl.zeros([RAYS], tl.float32)
    for k in range(most):
        i = last - 1 - k
        here = i >= first
        dt = tl.load(dt_m + i, mask=here, other=0.0)
        q = share * _mass(tl.load(t + i, mask=here, other=0.0), 0.5 * dt / norm, centre, deviation)
        tau = tl.load(sigma + i, mask=here, other=0.0) * dt
        # exp(tau) - 1; beyond 80 the quotient is nothing
        grown = _stopped(tau) * tl.exp(tl.minimum(tau, 80.0))
        given = tl.load(d_tau + i, mask=here, other=0.0)
        tl.store(d_tau + i, given + pull * (behind - q / tl.maximum(grown, _LEAST_OPACITY)), mask=here)
        behind += q


@triton.jit
def sight(  # type: ignore[no-untyped-def]
    offsets, weights, dt_m, t, norms, prior_m, deviation_m, scale, count, loss, d_weights, RAYS: tl.constexpr
):
    """Fill loss (count,) with URF's line of sight, add its gradient times scale to d_weights; see nerf.losses."""
    ray, real, first, last, most = _rays(offsets, count, RAYS)
    norm, centre = tl.load(norms + ray, mask=real, other=1.0), tl.load(prior_m + ray, mask=real, other=0.0)
    deviation = tl.load(deviation_m + ray, mask=real, other=1.0)
    pull = tl.load(scale + ray, mask=real, other=0.0)
    found = tl.zeros([RAYS], tl.float32)
    for k in range(most):
        i = first + k
        place = tl.load(t + i, mask=i < last, other=0.0)
        here = (i < last) & (centre > 0) & (place <= centre + _SIGHT_DEVIATIONS * deviation)
        half = 0.5 * tl.load(dt_m + i, mask=here, other=0.0) / norm
        near = place >= centre - _SIGHT_DEVIATIONS * deviation
        target = tl.where(near, _mass(place, half, centre, deviation), 0.0)
        off = tl.load(weights + i, mask=here, other=0.0) - target
        found += tl.where(here, off * off, 0.0)
        given = tl.load(d_weights + i, mask=here, other=0.0)
        tl.store(d_weights + i, given + pull * 2 * off, mask=here)
    tl.store(loss + ray, found, mask=real)


@triton.jit
def interlevel(  # type: ignore[no-untyped-def]
    offsets, weights, s0, s1, coarse_offsets, coarse_weights, coarse_s0, coarse_s1, scale, count, loss, d_coarse,
    RAYS: tl.constexpr,
):  # fmt: skip
    """Fill loss (count,), add to d_coarse: fine weights that coarse ones do not cover; see nerf.losses.interlevel."""
    ray, real, first, last, most = _rays(offsets, count, RAYS)
    low = tl.load(coarse_offsets + ray, mask=real, other=0)
    end = tl.load(coarse_offsets + ray + 1, mask=real, other=0)
    pull = tl.load(scale + ray, mask=real, other=0.0)
    found = tl.zeros([RAYS], tl.float32)
    for k in range(most):
        i = first + k
        here = i < last
        w = tl.load(weights + i, mask=here, other=0.0)
        start, stop = tl.load(s0 + i, mask=here, other=0.0), tl.load(s1 + i, mask=here, other=0.0)
        passed = here & (low < end) & (tl.load(coarse_s1 + low, mask=here & (low < end), other=0.0) <= start)
        while tl.max(passed.to(tl.int32), axis=0) > 0:
            low += passed.to(tl.int64)
            passed = here & (low < end) & (tl.load(coarse_s1 + low, mask=here & (low < end), other=0.0) <= start)
        high = low
        bound = tl.zeros([RAYS], tl.float32)
        meets = here & (high < end) & (tl.load(coarse_s0 + high, mask=here & (high < end), other=0.0) < stop)
        while tl.max(meets.to(tl.int32), axis=0) > 0:
            bound += tl.load(coarse_weights + high, mask=meets, other=0.0)
            high += meets.to(tl.int64)
            meets = here & (high < end) & (tl.load(coarse_s0 + high, mask=here & (high < end), other=0.0) < stop)
        over = tl.maximum(w - bound, 0.0)
        share = over / (w + _INTERLEVEL_SOFT)
        found += over * share
        for step in range(tl.max(high - low, axis=0).to(tl.int32)):
            place = low + step
            given = tl.load(d_coarse + place, mask=place < high, other=0.0)
            tl.store(d_coarse + place, given - pull * 2 * share, mask=place < high)
    tl.store(loss + ray, found, mask=real)
