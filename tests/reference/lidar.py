"""The LiDAR method's steps as loops: slow, obvious, and what the fast ones must equal."""

import numpy as np


def untwist(xyz_m, time_s, velocity):
    """One matrix exponential a point, by its series: p(t_ref) = Exp(t * angular) p + t * linear."""
    a, b, c = velocity[3:]
    turn = np.array([[0, -c, b], [c, 0, -a], [-b, a, 0]])
    t = time_s.astype(np.float64)[:, None]
    term = out = xyz_m.astype(np.float64)
    for power in range(1, 60):
        term = t * (term @ turn.T) / power
        out = out + term
    return out + t * velocity[:3]


def splat(sweeps, size, agree, free_m):
    """Z-buffer sweeps in the order given; each is (source, xyz_cam_m (n, 3), K)."""
    height, width = size
    depth_m, sources = np.full(size, np.inf, dtype=np.float32), np.full(size, 32767, dtype=np.int16)
    for source, xyz, K in sweeps:
        for x, y, z in xyz.astype(np.float64):
            if not (np.isfinite([x, y, z]).all() and z > 0):
                continue
            column, row = np.floor(K[0, 0] * x / z + K[0, 2] + 0.5), np.floor(K[1, 1] * y / z + K[1, 2] + 0.5)
            if not (0 <= column < width and 0 <= row < height):
                continue
            pixel = int(row), int(column)
            if z < free_m[pixel]:
                continue
            limit = float(depth_m[pixel])
            if sources[pixel] != source:
                limit *= 1 - agree
            if z < limit:
                depth_m[pixel], sources[pixel] = z, source
    return depth_m, sources


def hidden(depth_m, rows, columns, nearer):
    """A value is hidden where each quadrant (its own row and column included) holds a value nearer by the share."""
    out = np.zeros(depth_m.shape, dtype=bool)
    for v, u in np.argwhere(np.isfinite(depth_m)):
        limit = depth_m[v, u] * np.float32(1 - nearer)
        above, below = slice(max(0, v - rows), v + 1), slice(v, v + rows + 1)
        left, right = slice(max(0, u - columns), u + 1), slice(u, u + columns + 1)
        quadrants = [depth_m[y, x] for y in (above, below) for x in (left, right)]
        out[v, u] = all((quadrant < limit).any() for quadrant in quadrants)
    return out


def free_space(own_m, rows, columns, nearer):
    """Space is free up to the nearest sample around a pixel, less a share, where samples lie both above and below."""
    out = np.zeros(own_m.shape, dtype=np.float32)
    for v, u in np.ndindex(own_m.shape):
        x = slice(max(0, u - columns), u + columns + 1)
        above, below = own_m[max(0, v - rows) : v + 1, x].min(), own_m[v : v + rows + 1, x].min()
        if np.isfinite(above) and np.isfinite(below):
            out[v, u] = min(above, below) * np.float32(1 - nearer)
    return out


def confidence(depth_m, reach, steady):
    """Share of the window that has values, over 1 + (relative spread of their inverse depth / steady)^2."""
    out = np.zeros(depth_m.shape)
    for v, u in np.argwhere(np.isfinite(depth_m)):
        window = depth_m[max(0, v - reach) : v + reach + 1, max(0, u - reach) : u + reach + 1]
        inverse = 1 / window[np.isfinite(window)].astype(np.float64)
        out[v, u] = len(inverse) / window.size / (1 + (inverse.std() / inverse.mean() / steady) ** 2)
    return out


def deny(depth_m, matched_px, focal_baseline, slack_px, slack):
    """A depth is denied where its disparity is outside the range of the matches (> 0) in 3x3 pixels, if it has one."""
    out = np.zeros(depth_m.shape, dtype=bool)
    padded = np.pad(matched_px, 1)
    for v, u in np.argwhere(np.isfinite(depth_m) & (matched_px > 0)):
        around = padded[v : v + 3, u : u + 3]
        disparity = focal_baseline / float(depth_m[v, u])
        tolerance = slack_px + slack * disparity
        out[v, u] = not around[around > 0].min() - tolerance <= disparity <= around.max() + tolerance
    return out
