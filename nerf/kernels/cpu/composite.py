"""Volume rendering, compiled: near to far and back, of rays first_ray to last_ray. Equals nerf/twin/render.py."""

import math

import numpy as np

from nerf.types import INTERLEVEL_SOFT, LEAST_MASS, LEAST_OPACITY, SIGHT_DEVIATIONS
from priors.machine.compiled import FAST, compiled


@compiled(fastmath=FAST)
def forward(  # type: ignore[no-untyped-def]
    offsets, sigma, colour, t, dt_m, sky, floor, rgb, depth_m, median_m, transmittance, weights, first_ray, last_ray
):
    """Fill rgb (r, 3), depth_m, median_m, transmittance (r,) and weights (m,)."""
    for ray in range(first_ray, last_ray):
        optical, through = 0.0, 1.0
        red, green, blue, moment, middle = 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(offsets[ray], offsets[ray + 1]):
            tau = float(sigma[i]) * dt_m[i]
            w = -through * np.expm1(-tau)
            optical += tau
            after = np.exp(-optical)
            if through > 0.5 and after <= 0.5:
                middle = t[i]
            weights[i] = w
            red += w * colour[i, 0]
            green += w * colour[i, 1]
            blue += w * colour[i, 2]
            moment += w * t[i]
            through = after
        rgb[ray, 0] = red + through * sky[ray, 0]
        rgb[ray, 1] = green + through * sky[ray, 1]
        rgb[ray, 2] = blue + through * sky[ray, 2]
        depth_m[ray] = moment / max(-np.expm1(-optical), floor)
        median_m[ray] = middle
        transmittance[ray] = through


@compiled(fastmath=FAST)
def backward(  # type: ignore[no-untyped-def]
    offsets, sigma, colour, t, dt_m, sky, floor, depth_m, transmittance, weights,
    d_rgb, d_depth, d_transmittance, d_weights, d_tau, d_sigma, d_colour, d_sky, first_ray, last_ray,
):  # fmt: skip
    """Fill d_sigma (m,), d_colour (m, 3) and d_sky (r, 3) from the losses' gradients (nerf.types.Gradients)."""
    most = 0
    for ray in range(first_ray, last_ray):
        most = max(most, offsets[ray + 1] - offsets[ray])
    depths = np.empty(most)  # added up once: what a wall adds cannot be taken off again
    for ray in range(first_ray, last_ray):
        end = float(transmittance[ray])
        opacity = 1.0 - end
        d_end = float(d_transmittance[ray])
        for c in range(3):
            d_sky[ray, c] = d_rgb[ray, c] * end
            d_end += d_rgb[ray, c] * sky[ray, c]
        # depth = sum(w t) / max(opacity, floor), and opacity = sum(w)
        per_moment = d_depth[ray] / max(opacity, floor)
        per_opacity = -per_moment * depth_m[ray] if opacity > floor else 0.0
        first = offsets[ray]
        optical = 0.0
        for k in range(first, offsets[ray + 1]):
            optical += float(sigma[k]) * dt_m[k]
            depths[k - first] = optical
        behind = d_end * end
        for k in range(offsets[ray + 1] - 1, first - 1, -1):
            d_w = float(d_weights[k]) + per_moment * t[k] + per_opacity
            for c in range(3):
                d_w += d_rgb[ray, c] * colour[k, c]
                d_colour[k, c] = d_rgb[ray, c] * weights[k]
            # w = T (1 - exp(-tau)): its own tau adds T exp(-tau), every tau before takes w away
            d_sigma[k] = dt_m[k] * (d_w * np.exp(-depths[k - first]) - behind + d_tau[k])
            behind += d_w * weights[k]


@compiled(fastmath=FAST)
def distortion(offsets, weights, s0, s1, scale, loss, d_weights, first_ray, last_ray):  # type: ignore[no-untyped-def]
    """Add mip-NeRF 360's distortion of each ray to loss (r,), its gradient times scale (r,) to d_weights; O(samples).

    sum_ij w_i w_j |m_i - m_j| + sum_i w_i^2 (s1_i - s0_i) / 3, intervals in order (Barron et al., CVPR 2022, eq. 15).
    """
    for ray in range(first_ray, last_ray):
        total, moment = 0.0, 0.0
        for i in range(offsets[ray], offsets[ray + 1]):
            total += weights[i]
            moment += weights[i] * 0.5 * (s0[i] + s1[i])
        before, before_moment, value = 0.0, 0.0, 0.0
        for i in range(offsets[ray], offsets[ray + 1]):
            w, middle, width = float(weights[i]), 0.5 * (float(s0[i]) + s1[i]), float(s1[i]) - s0[i]
            after, after_moment = total - before - w, moment - before_moment - w * middle
            apart = middle * (before - after) - before_moment + after_moment
            value += w * apart + w * w * width / 3.0
            d_weights[i] += scale[ray] * (2.0 * apart + 2.0 * w * width / 3.0)
            before += w
            before_moment += w * middle
        loss[ray] += value


@compiled(inline="always")
def _mass(low, high, centre, deviation):  # type: ignore[no-untyped-def]
    """Return a normal distribution's mass between low and high."""
    root = 0.7071067811865476 / deviation
    return 0.5 * (math.erf((high - centre) * root) - math.erf((low - centre) * root))


@compiled(fastmath=FAST)
def kl(  # type: ignore[no-untyped-def]
    offsets, sigma, dt_m, t, norms, depth_m, deviation_m, scale, loss, d_tau, first_ray, last_ray
):
    """Fill loss (r,) with -sum q log w, add its gradient times scale (r,) to d_tau (m,); see nerf.losses."""
    for ray in range(first_ray, last_ray):
        loss[ray] = 0.0
        first, last = offsets[ray], offsets[ray + 1]
        if depth_m[ray] <= 0.0:
            continue
        total = 0.0
        for i in range(first, last):
            half = 0.5 * dt_m[i] / norms[ray]
            total += _mass(t[i] - half, t[i] + half, depth_m[ray], deviation_m[ray])
        if total < LEAST_MASS:
            continue
        optical, value = 0.0, 0.0
        for i in range(first, last):
            half = 0.5 * dt_m[i] / norms[ray]
            q = _mass(t[i] - half, t[i] + half, depth_m[ray], deviation_m[ray]) / total
            tau = float(sigma[i]) * dt_m[i]
            value -= q * (np.log(max(-np.expm1(-tau), LEAST_OPACITY)) - optical)
            optical += tau
        loss[ray] = value
        behind = 0.0
        for k in range(last - 1, first - 1, -1):
            half = 0.5 * dt_m[k] / norms[ray]
            q = _mass(t[k] - half, t[k] + half, depth_m[ray], deviation_m[ray]) / total
            tau = float(sigma[k]) * dt_m[k]
            d_tau[k] += scale[ray] * (behind - q / max(np.expm1(tau), LEAST_OPACITY))
            behind += q


@compiled(fastmath=FAST)
def sight(  # type: ignore[no-untyped-def]
    offsets, weights, dt_m, t, norms, depth_m, deviation_m, scale, loss, d_weights, first_ray, last_ray
):
    """Fill loss (r,) with URF's line of sight, add its gradient times scale (r,) to d_weights; see nerf.losses."""
    for ray in range(first_ray, last_ray):
        loss[ray] = 0.0
        if depth_m[ray] <= 0.0:
            continue
        reach = SIGHT_DEVIATIONS * deviation_m[ray]
        for i in range(offsets[ray], offsets[ray + 1]):
            if t[i] > depth_m[ray] + reach:
                continue
            target = 0.0
            if t[i] >= depth_m[ray] - reach:
                half = 0.5 * dt_m[i] / norms[ray]
                target = _mass(t[i] - half, t[i] + half, depth_m[ray], deviation_m[ray])
            off = weights[i] - target
            loss[ray] += off * off
            d_weights[i] += scale[ray] * 2.0 * off


@compiled(fastmath=FAST)
def interlevel(  # type: ignore[no-untyped-def]
    offsets, weights, s0, s1, coarse_offsets, coarse_weights, coarse_s0, coarse_s1, scale, loss, d_coarse,
    first_ray, last_ray,
):  # fmt: skip
    """Fill loss (r,) and d_coarse (m,): fine weights that coarse intervals do not cover; see nerf.losses.interlevel."""
    for ray in range(first_ray, last_ray):
        first, last = coarse_offsets[ray], coarse_offsets[ray + 1]
        d_coarse[first:last] = 0.0
        value, low = 0.0, first
        for i in range(offsets[ray], offsets[ray + 1]):
            while low < last and coarse_s1[low] <= s0[i]:
                low += 1
            bound, high = 0.0, low
            while high < last and coarse_s0[high] < s1[i]:
                bound += coarse_weights[high]
                high += 1
            over = weights[i] - bound
            if not over <= 0.0:  # NaN too
                share = over / (weights[i] + INTERLEVEL_SOFT)
                value += over * share
                for j in range(low, high):
                    d_coarse[j] -= scale[ray] * 2.0 * share
        loss[ray] = value
