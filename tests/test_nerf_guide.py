"""The drive's own truth as a prior: what it shows a fit, what it never shows, and drives that have none."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_nerf_scene import SIZE, Corridor, flat, prior

from cli.nerf import PROGRAM
from nerf.config import FitConfig
from nerf.guide import TRUTH, open_guide, place_of
from nerf.prepare import SceneConfig, open_scene
from nerf.run import begin, open_run
from nerf.split import HELD_OUT, split
from nerf.study import NONE, RunSpec
from nerf.study_table import prior_labels
from nerf.view.stage import NO_POINTS, open_stage
from priors.errors import DataError
from priors.filters import Filters
from priors.types import Depth, Frame


def depth_of(index: int) -> np.ndarray:
    return np.where(np.arange(SIZE[1]) % 2, 10.0 + index, 0).astype(np.float32) * np.ones(SIZE, np.float32)


class Known(Corridor):
    """A corridor with true depth of some frames; reading that of another one fails."""

    def __init__(self, with_truth: set[int], readable: set[int], count: int = 20) -> None:
        super().__init__(count)
        self.with_truth, self.readable = with_truth, readable

    def __getitem__(self, index: int) -> Frame:
        frame = super().__getitem__(index)
        readers: dict[str, Callable[..., Any]] = dict(frame.readers)
        if index in self.with_truth:
            readers["truth"] = lambda: self.truth(index)
        missing = {"truth": f"no map of frame {index}"}
        return Frame(frame.id, frame.camera, readers, missing, T_world_cam=frame.T_world_cam)

    def truth(self, index: int) -> Depth:
        assert index in self.readable, f"frame {index}'s truth was read"
        return Depth(depth_of(index))


ALL = set(range(20))
TEST = {9, 19}


def test_frames_that_are_not_held_out_show_their_truth(tmp_path: Path) -> None:
    made = open_scene(Known(ALL, ALL - TEST), TRUTH, SceneConfig("sparse"), tmp_path)
    assert made.depth_m is not None and made.weight is None and made.sky is not None
    for position in ALL - TEST:
        np.testing.assert_array_equal(made.depth_m[position], depth_of(position))
    assert all(not made.depth_m[position].any() for position in TEST), "a held-out frame's truth is not used"
    again = open_scene(Known(ALL, set()), TRUTH, SceneConfig("dense"), tmp_path)
    assert again.depth_m is not None and again.depth_m[3].any(), "it was copied before, and is not read again"


def test_held_out_is_what_is_held_out_of_the_range(tmp_path: Path) -> None:
    made = open_scene(Known(ALL, set(range(5, 20)) - {14}), TRUTH, SceneConfig(frames="5:20"), tmp_path)
    assert made.depth_m is not None and made.test == [9] and made.ids[9] == "000014"
    assert [bool(made.depth_m[position].any()) for position in (8, 9, 10)] == [True, False, True]


def test_the_truth_passes_the_filters(tmp_path: Path) -> None:
    made = open_scene(Known(ALL, ALL - TEST), TRUTH, SceneConfig(filters=Filters(clip=14.5)), tmp_path)
    assert made.depth_m is not None
    assert [bool(made.depth_m[position].any()) for position in (3, 4, 5)] == [True, True, False]
    with pytest.raises(DataError, match="no confidence to filter by"):
        open_scene(Known(ALL, ALL - TEST), TRUTH, SceneConfig(filters=Filters(keep=0.5)), tmp_path)


def test_a_frame_without_truth_has_no_value(tmp_path: Path) -> None:
    made = open_scene(Known({0, 1, 9}, {0, 1}), TRUTH, SceneConfig(), tmp_path)
    assert made.depth_m is not None
    assert [position for position in range(20) if made.depth_m[position].any()] == [0, 1]


@pytest.mark.parametrize(
    ("with_truth", "views", "said"),
    [
        (set(), "dense", "corridor: no true depth to learn from: no map of frame 0"),
        (TEST, "dense", "corridor: no true depth to learn from: no map of frame 0"),
        ({3}, "sparse", "corridor: its truth: no value in any of the 5 training frames"),
        (ALL, HELD_OUT, "corridor: its truth: no value in any of the 2 training frames"),
    ],
)
def test_without_truth_one_line_says_so(tmp_path: Path, with_truth: set[int], views: str, said: str) -> None:
    with pytest.raises(DataError, match=said):
        open_scene(Known(with_truth, ALL - TEST), TRUTH, SceneConfig(views), tmp_path)


def test_a_run_remembers_that_it_leant_on_the_truth(tmp_path: Path) -> None:
    drive = Known(ALL, ALL - TEST)
    run = begin(drive, TRUTH, SceneConfig("sparse"), FitConfig(steps=1), tmp_path / "run")
    assert (run.config.prior, run.config.title) == ("truth", "mip360-sparse-l1-truth")
    opened = open_run(run.folder).config
    assert opened.prior is not None and open_guide(opened.prior) is TRUTH
    assert run.scene.train == split(20, "sparse")[0]
    assert open_stage(run).remarks == (NO_POINTS,)


def test_a_folder_of_that_name_is_named_by_its_path(tmp_path: Path) -> None:
    made = prior(tmp_path / "cache", {"000003": flat(7.0)})
    assert place_of(open_guide(place_of(made))) == place_of(made) != place_of(TRUTH)
    made.folder.rename(tmp_path / "truth")
    assert place_of(open_guide(tmp_path / "truth")) == str((tmp_path / "truth").resolve())


def test_tables_call_it_truth_beside_others(tmp_path: Path) -> None:
    made = prior(tmp_path / "cache", {"000003": flat(7.0)})
    specs = [RunSpec("ngp", "dense", place) for place in (NONE, "truth", str(made.folder))]
    assert prior_labels(specs) == {NONE: NONE, "truth": "truth", str(made.folder): "m"}
    assert specs[1].name == "ngp-dense-truth-seed0"


def test_the_commands_take_it_and_say_where_there_is_none(
    street: Path,
    raw_drive: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["--views", "1/2", "--steps", "1"]
    assert PROGRAM.run(["fit", str(street), "--prior", "truth", *words, "--rays", "64", "--width", "16"]) == 0
    assert "guided by truth, loss l1" in capsys.readouterr().err
    assert open_run(next((tmp_path / "runs").glob("*1of2*"))).config.prior == "truth"
    for command in (["fit", "--prior"], ["study", "--priors"], ["bench", "--field", "ngp", "--priors"]):
        assert PROGRAM.run([command[0], str(raw_drive), *command[1:], "truth", "--steps", "1"]) == 1
        told = [line for line in capsys.readouterr().err.splitlines() if "no true depth to learn from" in line]
        assert len(told) == 1, command
