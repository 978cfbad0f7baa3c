"""Long drives in blocks: where the path is cut, how views blend, and one run, one report of them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from nerf_commands import SIZE, nerf, refused

from nerf import checkpoint
from nerf.blended import BlendedModel, blend
from nerf.blocks import OVERLAP, Blocks, load, part
from nerf.report import Report
from nerf.run import open_run
from nerf.scene import Scene
from nerf.types import RenderedView
from priors.errors import UsageError
from priors.street.write import write_street
from priors.types import Camera

pytestmark = pytest.mark.cluster


def straight(count: int, step_m: float = 1.0) -> Scene:
    """A scene of `count` frames along x; every tenth is held out."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 3] = step_m * np.arange(count)
    test = list(range(9, count, 10))
    train = [position for position in range(count) if position not in test]
    images = np.zeros((count, 2, 2, 3), np.uint8)
    return Scene(
        "path", list(map(str, range(count))), Camera(np.eye(3), (2, 2)), poses, images, None, None, train, test
    )


def test_blocks_are_equal_and_overlap() -> None:
    scene = straight(101)
    cut = Blocks.cut(scene, 26)
    assert cut.borders_m == [0, 25, 50, 75, 100]
    assert [cut.frames(number) for number in range(4)] == [range(32), range(19, 57), range(44, 82), range(69, 101)]
    block = cut.scene(scene, 1)
    assert block.train == [frame for frame in scene.train if 19 <= frame < 57] and block.test == [19, 29, 39, 49]
    assert np.array_equal(block.path, scene.T_world_cam[19:57]) and block.images is scene.images


def test_a_path_shorter_than_a_block_is_one_block() -> None:
    cut = Blocks.cut(straight(5), 100)
    assert len(cut) == 1 and cut.frames(0) == range(5)
    assert len(Blocks.cut(straight(3, 0.0), 10)) == 1, "a car that stands"


def test_blocks_of_too_few_views_are_refused() -> None:
    with pytest.raises(UsageError, match="--blocks 2: expected longer blocks"):
        Blocks.cut(straight(40, 5.0), 2)


@given(st.floats(-30, 130), st.floats(-5, 5), st.integers(1, 9))
def test_weights_sum_to_one_and_only_trained_blocks_count(x_m: float, y_m: float, count: int) -> None:
    """Wherever the camera is: its place along the path decides, and a block counts only where it was trained."""
    cut = Blocks.cut(straight(101), 100 / count)
    pose = np.eye(4)
    pose[:3, 3] = x_m, y_m, 0
    weights = cut.weights(pose)
    at_m = min(max(x_m, 0), 100)
    assert weights.sum() == pytest.approx(1) and (weights >= 0).all()
    for number in np.flatnonzero(weights > 0):
        low, high = cut.borders_m[number], cut.borders_m[number + 1]
        assert low - OVERLAP * (high - low) / 2 - 1e-6 <= at_m <= high + OVERLAP * (high - low) / 2 + 1e-6


def test_weights_change_smoothly_over_a_border() -> None:
    cut = Blocks.cut(straight(101), 50)
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = 50 - OVERLAP * 50 / 4, 50, 50 + OVERLAP * 50 / 4
    assert np.allclose([cut.weights(pose) for pose in poses], [[0.75, 0.25], [0.5, 0.5], [0.25, 0.75]])


def test_depths_blend_by_what_is_solid() -> None:
    def view(rgb: float, depth_m: float, median_m: float, opacity: float) -> RenderedView:
        maps = (np.full((2, 3), value, np.float32) for value in (depth_m, median_m, opacity))
        return RenderedView(np.full((2, 3, 3), rgb, np.float32), *maps)

    both = blend([view(0.2, 10, 10, 1.0), view(0.6, 30, 0, 0.0)], np.array([0.25, 0.75]))
    assert np.allclose(both.rgb, 0.5) and np.allclose(both.opacity, 0.25)
    assert np.allclose(both.depth_m, 10) and np.allclose(both.median_m, 10), "the sky has no depth"
    alone = view(0.2, 10, 10, 1.0)
    assert blend([alone], np.ones(1)) is alone


def test_a_long_street_is_one_run_of_blocks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It goes on where it was left, is scored over all its views, and cannot be cut otherwise afterwards."""
    write_street(tmp_path / "street", 20, 7, SIZE)
    run = tmp_path / "runs" / "long"
    words = ("fit", tmp_path / "street", "--rays", 64, "--device", "cpu", "--threads", 1, "--run", run)
    assert nerf(*words, "--blocks", 9, "--steps", 2) == 0
    cut = load(run)
    assert len(cut) >= 2
    assert nerf(*words, "--blocks", 9, "--steps", 4) == 0
    assert checkpoint.spent(run).step == 4 * len(cut)
    report = Report.load(run / "metrics.json")
    assert [frame.frame for frame in report.frames] == ["0000000009", "0000000019"]

    model, views = checkpoint.open_model(run, "cpu"), open_run(run).viewpoints()
    assert isinstance(model, BlendedModel)
    middle = views.T_world_cam[len(views.ids) // 2]
    near = cut.weights(middle)
    own = [checkpoint.open_model(part(run, number), "cpu").render(middle, views.camera) for number in range(len(cut))]
    seen = model.render(middle, views.camera).rgb
    assert np.allclose(seen, sum(w * view.rgb for w, view in zip(near, own, strict=True)), atol=1e-5)

    assert "settings" in refused(capsys, *words, "--blocks", 5, "--steps", 4)
    assert "has no blocks" in refused(capsys, *words[:-1], tmp_path / "other", "--blocks", 9, "--field", "splat")


def test_frames_that_are_cut_otherwise_are_another_run(tmp_path: Path) -> None:
    cut = Blocks.cut(straight(40), 10)
    cut.save(tmp_path)
    cut.save(tmp_path)
    with pytest.raises(Exception, match="cut otherwise"):
        replace(cut, borders_m=[0.0, 39.0]).save(tmp_path)
