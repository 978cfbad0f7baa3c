"""Maps joined: of moments and of sensors, on scenes whose depth is known; the flicker between two frames."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eval.calibration import Tolerance
from eval.flicker import View, flicker, read_between
from priors import error_model
from priors.error_model import METRE, PIXEL, WITHIN, chance_of, spread_of, within_5_percent
from priors.errors import DataError
from priors.fusion.moments import Moment, join_moments, pixel_motion
from priors.fusion.parts import Part, join_parts
from priors.types import Camera, Depth

pytestmark = pytest.mark.networks
SIZE = (40, 60)
CAMERA = Camera(np.array([[50.0, 0, 29.5], [0, 50.0, 19.5], [0, 0, 1]]), SIZE)
FX_BASELINE = 25.0


def pose(z_m: float) -> np.ndarray:
    """A camera z_m further along its axis."""
    T = np.eye(4)
    T[2, 3] = z_m
    return T


def wall(z_m: float, noise: float = 0.0, seed: int = 0, sure: float = 0.9) -> Depth:
    """A wall straight ahead, with noise in the depth's logarithm."""
    rng = np.random.default_rng(seed)
    depth_m = (z_m * np.exp(noise * rng.standard_normal(SIZE))).astype(np.float32)
    return Depth(depth_m, within_5_percent=np.full(SIZE, sure, np.float32))


@given(st.floats(2, 80), st.floats(0.01, 0.99), st.sampled_from([METRE, PIXEL, WITHIN, Tolerance(2.0, "px")]))
def test_a_chance_within_the_same_error_is_itself(z_m: float, chance: float, within: Tolerance) -> None:
    depth_m, chances = np.full((1, 1), z_m, np.float32), np.full((1, 1), chance, np.float32)
    spread = spread_of(depth_m, chances, within, FX_BASELINE)
    if error_model.LEAST < spread[0, 0] < error_model.MOST:
        np.testing.assert_allclose(chance_of(depth_m, spread, within, FX_BASELINE), chances, rtol=1e-3)
    wider = chance_of(depth_m, spread, replace(within, amount=2 * within.amount), FX_BASELINE)
    assert wider[0, 0] >= chance_of(depth_m, spread, within, FX_BASELINE)[0, 0]


def test_what_is_sure_in_metres_is_sure_in_five_percent_by_its_distance() -> None:
    depth = Depth(np.array([[4, 20, 80, 0]], np.float32), np.array([[0.9, 0.9, 0.9, 0]], np.float32))
    near, equal, far, none = within_5_percent(depth, METRE)[0]
    assert near < equal < far and none == 0
    assert equal == pytest.approx(0.9, abs=1e-3), "5 % of 20 m is a metre"
    with pytest.raises(ValueError, match="fx_baseline"):
        within_5_percent(depth, PIXEL)


def test_a_still_scene_becomes_steady() -> None:
    """Five maps of a wall with independent noise: the error falls as that of a mean does, and nothing is moved."""
    moments = [Moment(wall(20 - k, 0.02, seed=k + 5), CAMERA, pose(k), k) for k in range(-2, 3)]
    own, others = moments[2], [moments[k] for k in (0, 1, 3, 4)]
    joined = join_moments(own, others)
    inner = np.s_[4:-4, 4:-4]
    before, after = (np.log(depth.depth_m / 20)[inner] for depth in (own.depth, joined))
    assert after.std() < 0.6 * before.std() and abs(after.mean()) < 2e-3
    assert joined.consistency is not None and joined.consistency[inner].mean() > 0.8


def test_what_moves_is_left_alone() -> None:
    """A car that keeps its distance, before a still wall: the wall is joined, the car is not."""
    car = np.s_[10:30, 20:40]

    def view(k: int) -> Moment:
        depth = wall(30.0 - k)
        depth.depth_m[car] = 20.0
        return Moment(depth, CAMERA, pose(k), k)

    one_sided = [view(1), view(2)]  # as at a drive's first frame: errors do not cancel
    joined = join_moments(view(0), one_sided)
    np.testing.assert_allclose(joined.depth_m[14:26, 24:36], 20.0, rtol=1e-3)
    np.testing.assert_allclose(joined.depth_m[2:6, 2:6], 30.0, rtol=1e-3)


def test_edges_stay_and_holes_stay() -> None:
    near = np.zeros(SIZE, bool)
    near[:, 30:] = True

    def view(k: int) -> Moment:
        depth = wall(40.0 - k)
        depth.depth_m[near] = 10.0 - k
        depth.depth_m[:4] = 0
        return Moment(depth, CAMERA, pose(k), k)

    joined = join_moments(view(0), [view(-1), view(1)])
    assert set(np.unique(np.rint(joined.depth_m))) == {0, 10, 40} and not joined.depth_m[:4].any()
    assert not join_moments(view(0), []).depth_m[:4].any(), "and alone"


def test_maps_are_looked_up_as_the_slow_twin_does() -> None:
    from priors.kernels.reprojection import look_up

    rng = np.random.default_rng(3)
    own_m = rng.uniform(5, 9, SIZE).astype(np.float32)
    other_m = rng.uniform(6, 6.4, SIZE).astype(np.float32)
    own_m[rng.random(SIZE) < 0.1] = 0
    other_m[rng.random(SIZE) < 0.1] = 0
    T = pose(0.7)
    T[:2, 3] = 0.1, -0.05
    one, other = Moment(Depth(own_m), CAMERA, np.eye(4)), Moment(Depth(other_m), CAMERA, T)
    there, back = pixel_motion(one, other), pixel_motion(other, one)
    found, place = np.empty(SIZE, np.float32), np.empty(SIZE, np.int32)
    look_up(own_m, other_m, there, back, found, place, 0, SIZE[0])
    rows, columns = np.nonzero(own_m)
    z = own_m[rows, columns].astype(np.float64)
    x, y, w = there[:, :3] @ np.stack([columns * z, rows * z, z]) + there[:, 3:]
    u, v = x / w, y / w
    inside = (u >= 0) & (v >= 0) & (u <= SIZE[1] - 1) & (v <= SIZE[0] - 1)
    rows, columns, z, u, v = rows[inside], columns[inside], z[inside], u[inside], v[inside]
    seen = read_between(other_m, u, v)
    again = back[2, :3] @ np.stack([u * seen, v * seen, seen]) + back[2, 3]
    expected = np.where(seen > 0, np.log(np.where(seen > 0, again, 1) / z), np.nan)
    np.testing.assert_allclose(found[rows, columns], expected, atol=1e-4)
    np.testing.assert_array_equal(place[rows, columns] >= 0, seen > 0)


def test_flicker_is_the_median_change_of_what_both_see() -> None:
    def view(z_m: float, at_m: float, own_m: np.ndarray | float) -> View:
        truth_m = np.full(SIZE, z_m, np.float32)
        return View(np.broadcast_to(np.float32(own_m), SIZE), truth_m, CAMERA.K, pose(at_m))

    assert flicker(view(20, 0, 20), view(19, 1, 19)) == pytest.approx(0, abs=1e-6)
    assert flicker(view(20, 0, 20 * 1.1), view(19, 1, 19)) == pytest.approx(np.log(21 / 19), rel=1e-5)
    moved = view(20, 1, 20)  # it keeps its distance: not static
    assert np.isnan(flicker(view(20, 0, 20), moved))
    hidden = view(19, 1, 19)
    hidden.truth_m[:] = 5.0  # something nearer stands before it
    assert np.isnan(flicker(view(20, 0, 20), hidden))


def test_the_most_credible_part_is_the_surface() -> None:
    stereo, mono = wall(20.0, sure=0.9), wall(30.0, sure=0.8)
    stereo.within_5_percent[:, :10] = 0.05  # type: ignore[index]
    joined = join_parts({"stereo": Part(stereo, "matched"), "mono": Part(mono, "inferred")})
    np.testing.assert_allclose(joined.depth_m[:, :10], 30.0, rtol=1e-5)
    np.testing.assert_allclose(joined.depth_m[:, 10:], 20.0, rtol=1e-5), "two surfaces are not averaged"


def test_parts_that_agree_are_averaged_and_each_alone_is_itself() -> None:
    one, other = wall(20.0, sure=0.9), wall(20.2, sure=0.9)
    both = join_parts({"stereo": Part(one, "matched"), "completion": Part(other, "matched")})
    np.testing.assert_allclose(both.depth_m, np.sqrt(20.0 * 20.2), rtol=1e-4)
    alone = join_parts({"stereo": Part(one, "matched")})
    np.testing.assert_allclose(alone.depth_m, one.depth_m, rtol=1e-6)
    np.testing.assert_allclose(alone.trust(), one.within_5_percent, atol=1e-4)


def test_what_was_measured_stays_unless_a_surer_part_denies_it() -> None:
    lidar = wall(15.0, sure=0.8)
    lidar.depth_m[:, ::2] = 0
    agreeing, denying = wall(15.3, sure=0.95), wall(40.0, sure=0.999)
    stays = join_parts({"lidar": Part(lidar, "measured"), "stereo": Part(agreeing, "matched")}).depth_m
    np.testing.assert_allclose(stays[:, 1::2], 15.0, rtol=1e-6)
    np.testing.assert_allclose(stays[:, ::2], 15.3, rtol=1e-6)
    goes = join_parts({"lidar": Part(lidar, "measured"), "stereo": Part(denying, "matched")}).depth_m
    np.testing.assert_allclose(goes, 40.0, rtol=1e-6)


def test_parts_of_other_cameras_are_refused() -> None:
    small = Depth(np.ones((5, 6), np.float32))
    with pytest.raises(DataError, match=r"different cameras: stereo 60x40, mono 6x5"):
        join_parts({"stereo": Part(wall(20.0), "matched"), "mono": Part(small, "inferred")})
