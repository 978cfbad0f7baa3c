"""`--reuse N`: maps carried on from the frame before, and chains, whose maps depend on nothing but their frames."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from factories import drive_folder
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import carry as twin

from cli.priors import PROGRAM
from priors import build, cache, keys
from priors.build.chains import VERSION, Chains
from priors.drives import open_drive
from priors.errors import DataError, UsageError
from priors.kernels.carry import carry
from priors.methods._stereo_carried import MORE_SURE, MORE_SURE_BESIDE_OUTLINE, Merged
from priors.methods.lidar import Lidar
from priors.methods.stereo import Stereo
from priors.naming import labels
from priors.report.typed import build_command
from priors.selection import Selection
from priors.types import Depth, Drive, Earlier, Frame, Input, Method

pytestmark = pytest.mark.stress
N = 3
K = np.array([[60.0, 0, 11.5], [0, 60.0, 7.5], [0, 0, 1]])
FX_BASELINE = 30.0


def moved(x: float = 0, y: float = 0, z: float = 0) -> np.ndarray:
    """The camera before in the camera now, which stands at (x, y, z) of the one before."""
    T = np.eye(4)
    T[:3, 3] = -x, -y, -z
    return T


def test_standing_still_changes_nothing() -> None:
    disparity_px = np.random.default_rng(1).uniform(1, 40, (16, 24)).astype(np.float32)
    out, trust = carry(disparity_px, disparity_px / 40, np.eye(4), K, FX_BASELINE)
    np.testing.assert_array_equal(out, disparity_px)
    np.testing.assert_array_equal(trust, disparity_px / 40)


@pytest.mark.parametrize("forward_m", [-0.4, 0.7, 2.0])
def test_a_wall_comes_nearer_without_cracks(forward_m: float) -> None:
    wall_px = np.full((16, 24), 5, np.float32)  # 6 m
    out, _ = carry(wall_px, np.ones_like(wall_px), moved(z=forward_m), K, FX_BASELINE)
    seen = out > 0
    assert seen.all() if forward_m > 0 else 0.5 < seen.mean() < 1
    np.testing.assert_allclose(out[seen], FX_BASELINE / (6 - forward_m), rtol=1e-5)


def test_a_road_keeps_its_plane() -> None:
    rows = np.arange(16)[:, None] - K[1, 2]
    road_px = np.where(rows > 0, FX_BASELINE * rows / (1.6 * K[1, 1]), 0) * np.ones((1, 24))  # 1.6 m below
    out, _ = carry(road_px.astype(np.float32), np.ones((16, 24), np.float32), moved(z=1), K, FX_BASELINE)
    seen = out[9:] > 0  # a plane along the way stays what it is
    assert seen.mean() > 0.95
    np.testing.assert_allclose(out[9:][seen], road_px[9:][seen], atol=0.02)


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10**6), st.floats(-0.5, 1.5), st.floats(-0.3, 0.3))
def test_it_equals_the_slow_twin(seed: int, forward_m: float, aside_m: float) -> None:
    rng = np.random.default_rng(seed)
    disparity_px = rng.choice([0, 4, 5, 14], (7, 9)).astype(np.float32) + rng.uniform(0, 0.5, (7, 9)).astype(np.float32)
    trust = rng.uniform(0, 1, (7, 9)).astype(np.float32)
    T = moved(aside_m, 0.03, forward_m)
    out, out_trust = carry(disparity_px, trust, T, K, FX_BASELINE)
    slow, slow_trust = twin.carry(disparity_px, trust, T, K, FX_BASELINE)
    same = np.abs(out - slow) < 1e-3
    assert same.mean() > 0.96  # ties and edges of a patch may fall to either side by rounding
    np.testing.assert_allclose(out_trust[same], slow_trust[same], atol=1)


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0, 0.0, 1e-30, 1e30])
def test_values_that_are_none_spoil_nothing(value: float) -> None:
    disparity_px = np.full((8, 10), 5, np.float32)
    disparity_px[3, 4] = value
    out, _ = carry(disparity_px, np.ones_like(disparity_px), moved(z=0.1), K, FX_BASELINE)
    assert np.isfinite(out).all() and (out[:, 7:] > 0).all()


def test_a_value_is_less_sure_beside_an_outline_and_more_where_the_pair_confirms_it() -> None:
    near = np.zeros((20, 40), bool)
    near[:, 20:] = True
    disparity_px = np.where(near, 30, 10).astype(np.float32)
    rows = np.arange(20)[:, None] * np.ones((1, 40))
    confirmed, kept = rows >= 12, rows >= 6
    change = Merged(disparity_px, confirmed, kept, disparity_px).more_sure
    outline = np.abs(np.arange(40) - 19.5) < 2
    for y in range(20):
        for x in range(40):
            at = int(kept[y, x]) + int(confirmed[y, x])
            wanted = MORE_SURE_BESIDE_OUTLINE[at] if outline[x] else MORE_SURE[at]
            assert change[y, x] == pytest.approx(wanted), (y, x)
    assert MORE_SURE[0] < MORE_SURE[1] < 0 < MORE_SURE[2]
    assert all(beside < away for beside, away in zip(MORE_SURE_BESIDE_OUTLINE, MORE_SURE, strict=True))


@dataclass(frozen=True)
class Counting(Method):
    """Each map holds the number of the step in its chain; a frame whose id is in `broken` must be made whole."""

    broken: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        return "counting"

    @property
    def reads(self) -> tuple[Input, ...]:
        return ("image",)

    @property
    def carries(self) -> bool:
        return True

    def resolve(self, frame: Frame) -> Any:
        return self

    def __call__(self, frame: Frame) -> Depth:
        frame.image()
        return Depth(np.ones(frame.camera.size, np.float32))

    def carry_on(self, frame: Frame, before: Earlier) -> Depth | None:
        frame.image()
        return None if frame.id in self.broken else replace(before.depth, depth_m=before.depth.depth_m + 1)


def made(folder: Path, drive: Drive, method: Method, **how: Any) -> dict[str, float]:
    """Build chains of N and return each map's value by the number of its frame."""
    job = build.prepare(drive, method, folder=folder, reuse=N)
    report = job.run(job.plan(how.pop("selection", Selection())), **how)
    assert not report.failed
    return {id_[-2:].lstrip("0") or "0": float(report.prior.read(id_).depth_m.max()) for id_ in report.prior.ids()}


WHOLE = {str(number): 1.0 + number % N for number in range(10)}


@pytest.fixture
def drive(street: Path) -> Drive:
    return open_drive(street)


def test_every_nth_is_whole_and_the_others_follow(drive: Drive, tmp_path: Path) -> None:
    found = made(tmp_path, drive, Counting())
    assert found == {name: WHOLE[name] for name in found} and len(found) == len(drive.ids)


@pytest.mark.parametrize(
    "choose",
    [
        lambda drive, folder: made(folder, drive, Counting(), workers=3),
        lambda drive, folder: made(folder, drive, Counting(), selection=Selection("2:5")),
        lambda drive, folder: made(folder, drive[2:5], Counting()),
        lambda drive, folder: made(folder, drive[::-1], Counting()),
        lambda drive, folder: [made(folder, drive, Counting(), selection=Selection(shard=f"{i}/2")) for i in (2, 1)][1],
        lambda drive, folder: [made(folder, drive, Counting(), selection=Selection(f"{i}:{i + 1}")) for i in (5, 2)][1],
    ],
    ids=["workers", "range", "stretch", "backwards", "shards", "one by one"],
)
def test_maps_depend_on_nothing_else(
    drive: Drive, tmp_path: Path, choose: Callable[[Drive, Path], dict[str, float]]
) -> None:
    found = choose(drive, tmp_path)
    assert found and found == {name: WHOLE[name] for name in found}


def test_shards_take_whole_chains(drive: Drive) -> None:
    chains = Chains(drive, N)
    parts = [chains.shard(range(1, 6), f"{i}/2") for i in (1, 2)]
    assert parts == [[1, 2], [3, 4, 5]]
    assert Chains(drive).shard(range(5), "2/2") == [1, 3]


def test_a_frame_that_cannot_be_carried_begins_anew(drive: Drive, tmp_path: Path) -> None:
    found = made(tmp_path, drive, Counting(broken=(drive.ids[1],)))
    assert [found[str(number)] for number in range(5)] == [1, 1, 2, 1, 2]


def test_a_changed_image_makes_the_rest_of_its_chain_stale(own_street: Path, tmp_path: Path) -> None:
    drive = open_drive(own_street)
    made(tmp_path, drive, Counting())
    image = sorted((drive_folder(own_street) / "image_02" / "data").iterdir())[1]
    shutil.copy(sorted(image.parent.iterdir())[0], image)
    job = build.prepare(open_drive(own_street), Counting(), folder=tmp_path, reuse=N)
    assert [int(id_) for id_ in job.plan().stale] == [1, 2]


def test_the_key_has_it_only_where_it_is_used(drive: Drive, tmp_path: Path) -> None:
    plain, one, four = (
        build.prepare(drive, Counting(), folder=tmp_path, **how).prior.manifest
        for how in ({}, {"reuse": 1}, {"reuse": 4})
    )
    assert plain == one and "reuse" not in plain
    assert four["key"] != plain["key"] and four["reuse"] == {"frames": 4, "version": VERSION}
    assert keys.key({**four, "reuse": {"frames": 3, "version": VERSION}}, Counting) != four["key"]


def test_wrong_wishes_are_one_line(drive: Drive, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--reuse 4: lidar cannot carry a map on, stereo can: leave --reuse out"):
        build.prepare(drive, Lidar(), folder=tmp_path, reuse=4)
    for wrong in (0, -2, 101):
        with pytest.raises(DataError, match=f"--reuse {wrong}: expected a whole number from 1 to 100"):
            build.prepare(drive, Counting(), folder=tmp_path, reuse=wrong)


def test_a_drive_without_poses_is_told(image_folder: Path, tmp_path: Path) -> None:
    (image_folder / "poses.txt").unlink(missing_ok=True)
    with pytest.raises(UsageError, match=r"--reuse 2: maps are carried on by the poses: .*: leave --reuse out"):
        build.prepare(open_drive(image_folder), Stereo(), folder=tmp_path, reuse=2)


def test_the_command(street: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Stereo of the street, carried: nearly as right, named, and what is typed makes it again."""
    words = ["build", str(street), "--method", "stereo", "--stereo.offset-px", "0", "--cache", str(tmp_path)]
    assert PROGRAM.run(words) == 0
    assert PROGRAM.run([*words, "--reuse", "3"]) == 0
    assert "of the built were made of the frame before" in capsys.readouterr().out
    plain, reused = sorted(cache.find(tmp_path), key=lambda prior: "reuse" in prior.manifest)
    assert labels([plain, reused])[1] == "stereo reuse=3" and "--reuse 3" in build_command(reused)
    drive = open_drive(street)
    errors = []
    for prior in (plain, reused):
        frames = [(prior.read(frame.id).depth_m, frame.truth().depth_m) for frame in drive]
        errors.append(np.mean([np.median(np.abs(m - t)[t > 0] / t[t > 0]) for m, t in frames]))
    assert errors[1] < 1.25 * errors[0]
    assert (plain.depth_path(drive.ids[3]).read_bytes()) == (reused.depth_path(drive.ids[3]).read_bytes())
