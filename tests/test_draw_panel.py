"""Pictures: fixed scales, black where there is nothing, and drawn what was asked for."""

import numpy as np
import pytest

from priors.draw import colours, panel
from priors.draw.colours import (
    ERROR_STEPS,
    GOOD_TO_BAD,
    MISSING,
    colour_confidence,
    colour_depth,
    colour_error,
    thicken,
)
from priors.draw.panel import Tile
from priors.types import Depth

pytestmark = pytest.mark.filterwarnings("error")

EXTREMES = np.array([[0, -1, np.nan, 1.4e-45, 1e-3, 5, 65504, 1e30, np.inf]], np.float32)


def index_of(colour, table):
    (found,) = np.flatnonzero((table == colour).all(axis=1))
    return found


def test_depth_colours_are_a_fixed_scale_and_black_is_no_value():
    painted = colour_depth(np.array([[0, 3, 15.49, 80]], np.float32))[0]
    assert painted[0].tolist() == [0, 0, 0]
    assert painted[1].tolist() == colours.DEPTH_COLOURS[-1].tolist()
    assert painted[3].tolist() == colours.DEPTH_COLOURS[0].tolist()
    assert abs(int(index_of(painted[2], colours.DEPTH_COLOURS)) - 127) <= 1  # sqrt(3 * 80): the middle of the logs
    other = colour_depth(np.array([[3, 20]], np.float32))[0]
    assert other[0].tolist() == painted[1].tolist()  # another frame, the same colour


def test_no_colour_of_a_scale_is_near_black():
    for table in (colours.DEPTH_COLOURS, colours.CONFIDENCE_COLOURS, GOOD_TO_BAD):
        assert table.max(axis=1).min() > 60
    assert not (np.array(MISSING) == GOOD_TO_BAD).all(axis=1).any()


def test_extreme_maps_are_painted_without_a_warning():
    for truth in (EXTREMES, EXTREMES[:, ::-1]):
        for painted in (
            colour_depth(EXTREMES),
            colour_error(EXTREMES, truth),
            colour_confidence(EXTREMES, EXTREMES > 0),
        ):
            assert painted.dtype == np.uint8
            assert painted.shape == (1, 9, 3)
    assert colour_depth(EXTREMES)[0, :3].tolist() == [[0, 0, 0]] * 3
    assert colour_depth(EXTREMES)[0, 3].tolist() == colours.DEPTH_COLOURS[-1].tolist()


def test_error_colours_step_at_their_edges():
    shares = np.array([0.0, *(0.9 * step for step in ERROR_STEPS), 0.5])
    truth = np.full((1, 9), 10.0, np.float32)
    for sign in (1, -1):
        painted = colour_error((truth * (1 + sign * shares)).astype(np.float32), truth)[0]
        assert [int(index_of(colour, GOOD_TO_BAD)) for colour in painted] == [0, 0, 1, 2, 3, 4, 5, 6, 7]


def test_a_truth_without_a_prediction_is_neither_good_nor_black():
    painted = colour_error(np.array([[0, 5, 0]], np.float32), np.array([[5, 0, 0]], np.float32))[0]
    assert painted.tolist() == [list(MISSING), [0, 0, 0], [0, 0, 0]]


def test_thickening_grows_into_black_only():
    sparse = np.zeros((5, 9, 3), np.uint8)
    sparse[2, 2], sparse[2, 6] = (255, 0, 0), (0, 255, 0)
    grown = thicken(sparse)
    assert grown[1:4, 1:4].tolist() == [[[255, 0, 0]] * 3] * 3
    assert grown[1:4, 5:8].tolist() == [[[0, 255, 0]] * 3] * 3
    assert not grown[:, [0, 4, 8]].any()
    assert (grown[2, [2, 6]] == sparse[2, [2, 6]]).all()
    assert thicken(np.zeros((3, 4, 3), np.uint8)).any() == False  # noqa: E712
    assert (thicken(np.full((3, 4, 3), 7, np.uint8)) == 7).all()


def test_error_tile_shows_the_few_values_of_a_sparse_map():
    truth = np.full((20, 30), 10.0, np.float32)
    prediction = np.zeros_like(truth)
    prediction[10, 15] = 20
    tile = panel.error_tile(Depth(prediction), Depth(truth))
    assert (tile.picture[9:12, 14:17] == GOOD_TO_BAD[-1]).all()
    assert tile.picture[0, 0].tolist() == list(MISSING)
    assert "no value" in tile.caption
    dense = panel.error_tile(Depth(truth), Depth(truth))
    assert (dense.picture == GOOD_TO_BAD[0]).all()
    assert "no value" not in dense.caption


def test_confidence_tile_of_a_map_without_one_is_black():
    depth_m = np.full((4, 5), 9.0, np.float32)
    assert not panel.confidence_tile(Depth(depth_m)).picture.any()
    sure = panel.confidence_tile(Depth(depth_m, np.ones_like(depth_m))).picture
    assert (sure == colours.CONFIDENCE_COLOURS[-1]).all()


def test_sparse_depth_and_confidence_are_thickened_alike():
    depth_m = np.zeros((9, 9), np.float32)
    depth_m[4, 4] = 9
    depth = Depth(depth_m, (depth_m > 0).astype(np.float32))
    for tile in (panel.depth_tile(depth, "lidar"), panel.confidence_tile(depth)):
        assert tile.picture.any(axis=2).sum() == 9


def test_panel_lays_tiles_out_and_scales_them():
    red, green = (np.zeros((10, 40, 3), np.uint8) for _ in range(2))
    red[...], green[...] = (200, 0, 0), (0, 200, 0)
    made = panel.panel([Tile(red, "a", panel.depth_bar()), Tile(green, "b"), Tile(red[:5], "c")], 2, 200)
    gap, strip = panel.GAP_PX, panel.STRIP_PX
    assert made.dtype == np.uint8
    assert made.shape == (3 * gap + 2 * strip + 50 + 25, 3 * gap + 400, 3)
    assert (made[gap + strip : gap + strip + 50, gap : gap + 200] == (200, 0, 0)).all()
    assert (made[gap + strip : gap + strip + 50, 2 * gap + 200 : 2 * gap + 400] == (0, 200, 0)).all()
    assert (made[2 * gap + strip + 50 :, 2 * gap + 200 :] == panel.PAPER).all()  # no fourth tile


def test_captions_and_bars_are_drawn():
    blank = np.zeros((10, 300, 3), np.uint8)
    drawn = panel.panel([Tile(blank, "stereo", panel.error_bar())], 1, 300)
    strip = drawn[panel.GAP_PX : panel.GAP_PX + panel.STRIP_PX]
    assert {tuple(colour) for colour in GOOD_TO_BAD.tolist()} <= {tuple(c) for c in strip.reshape(-1, 3).tolist()}
    assert (strip[:, :80] != panel.PAPER).any()
    assert (panel.panel([Tile(blank, "")], 1, 300)[:40, :80] == panel.PAPER).all()


def test_a_long_caption_ends_before_the_bar() -> None:
    """The bar's own pixels are the same whatever the caption says."""
    tiles = [Tile(np.zeros((20, 60, 3), np.uint8), caption, panel.depth_bar()) for caption in ("", "long " * 60)]
    plain, captioned = (panel.panel([tile], 1, 400) for tile in tiles)
    right = 400 - 400 // 3 - 50
    np.testing.assert_array_equal(plain[:, right:], captioned[:, right:])
    assert not np.array_equal(plain[:, :right], captioned[:, :right])
