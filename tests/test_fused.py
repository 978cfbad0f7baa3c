"""`--method fused` and `--temporal`: made of maps that lie in the cache under their own keys, whatever came first."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from cli.priors import build as command
from cli.priors import eval as score_command
from eval.protocol import preset
from eval.result import Result
from priors import build, cache
from priors.build.stored import StoredMaps
from priors.drives import DriveOptions, open_drive
from priors.errors import DataError, UsageError
from priors.methods.completion import Completion
from priors.methods.fused import Fused
from priors.methods.lidar import Lidar
from priors.methods.stereo import Stereo
from priors.score import score
from priors.selection import Selection
from priors.types import Depth

pytestmark = pytest.mark.networks
TWO = Fused(parts=("lidar", "stereo"))


def test_the_parts_lie_under_their_own_keys(street: Path, tmp_path: Path) -> None:
    drive = open_drive(street)
    notes: list[str] = []
    one = build.prepare(drive, TWO, folder=tmp_path)
    prior = one.run(one.plan(Selection(frames="2:3")), on_note=notes.append).prior
    assert notes[0] == "fused: made of lidar and stereo"
    stereo = build.prepare(drive, Stereo(), folder=tmp_path)
    assert stereo.prior.ids() == prior.ids() == [drive.ids[2]]
    assert not stereo.plan(Selection(frames="2:3")).todo, "what fused built is stereo's own"
    lidar = build.prepare(drive, Lidar(), folder=tmp_path).prior.read(drive.ids[2])
    fused = prior.read(drive.ids[2])
    stays = lidar.valid & (fused.depth_m == lidar.depth_m)
    assert np.count_nonzero(stays) > 0.9 * np.count_nonzero(lidar.valid), "measured points stay"
    assert fused.density > 0.95 and fused.within_5_percent is not None


def test_fused_is_no_worse_than_any_part_where_that_has_a_value(street: Path, tmp_path: Path) -> None:
    drive = open_drive(street)
    fused = build.prepare(drive, TWO, folder=tmp_path).run().prior
    for part in (Lidar(), Stereo()):
        prior = build.prepare(drive, part, folder=tmp_path).prior
        figures = []
        for name, maps in (("own", prior), ("fused", fused)):
            same = cache.create(tmp_path / "same" / f"{name}-{part.name}", {**maps.manifest})
            for id_ in drive.ids:
                same.write(id_, maps.read(id_).keep(prior.read(id_).valid), 0.0)
            figures.append(score(same, drive, preset("paper")).result.metrics())
        own, joined = figures
        assert joined["abs_rel"] <= own["abs_rel"] + 1e-4 and joined["rmse"] <= own["rmse"] + 5e-3, part.name


def test_one_part_is_that_part(street: Path, tmp_path: Path) -> None:
    drive = open_drive(street)
    job = build.prepare(drive, Fused(parts=("stereo",)), folder=tmp_path)
    prior = job.run(job.plan(Selection(frames="1:2"))).prior
    alone = build.prepare(drive, Stereo(), folder=tmp_path).prior.read(drive.ids[1])
    np.testing.assert_allclose(prior.read(drive.ids[1]).depth_m, alone.depth_m, atol=1 / 256)


def test_parts_that_a_drive_lacks(image_folder: Path, tmp_path: Path) -> None:
    drive = open_drive(image_folder)
    assert Fused().resolve(drive[0]).parts == ("stereo", "mono"), "no LiDAR: without it"
    with pytest.raises(DataError, match=r"fused: no lidar: "):
        build.prepare(drive, TWO, folder=tmp_path)
    with pytest.raises(UsageError, match=r"--fused\.parts radar: expected some of"):
        Fused(parts=("radar",))  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="each once"):
        Fused(parts=("lidar", "lidar"))
    with pytest.raises(UsageError, match="nothing"):
        Fused(parts=())


def test_a_frame_without_one_part_says_so(own_street: Path, tmp_path: Path) -> None:
    for path in sorted(own_street.rglob("velodyne_points/data/*"))[:1]:
        path.unlink()
    drive = open_drive(own_street)
    notes: list[str] = []
    alone = Fused(parts=("lidar", "stereo"), lidar=Lidar(sweeps=1))
    job = build.prepare(drive, alone, folder=tmp_path)
    report = job.run(job.plan(Selection(frames="0:2")), on_note=notes.append)
    assert not report.failed and any(f"frame {drive.ids[0]}: fused without lidar: no sweep" in note for note in notes)


def test_what_decides_a_part_decides_the_key(street: Path, tmp_path: Path) -> None:
    drive = open_drive(street)

    def key(method: Fused) -> str:
        return build.prepare(drive, method, folder=tmp_path).prior.name

    assert key(TWO) == key(Fused(parts=("stereo", "lidar"))), "the order of the flags decides nothing"
    assert key(TWO) != key(Fused(parts=("lidar", "stereo"), lidar=Lidar(sweeps=3)))
    assert key(TWO) == key(Fused(parts=("lidar", "stereo"), completion=Completion(reach_px=3))), "it is no part"


def test_a_changed_input_of_a_part_makes_the_map_stale(own_street: Path, tmp_path: Path) -> None:
    drive = open_drive(own_street)
    chosen = Selection(frames="2:3")
    for temporal in (0, 1):
        job = build.prepare(drive, TWO, folder=tmp_path / str(temporal), temporal=temporal)
        job.run(job.plan(chosen))
        again = build.prepare(open_drive(own_street), TWO, folder=tmp_path / str(temporal), temporal=temporal)
        assert not again.plan(chosen).todo
    image = next(own_street.rglob(f"image_03/data/{drive.ids[2]}.*"))
    shutil.copy(next(own_street.rglob(f"image_03/data/{drive.ids[3]}.*")), image)
    for temporal in (0, 1):
        again = build.prepare(open_drive(own_street), TWO, folder=tmp_path / str(temporal), temporal=temporal)
        plan = again.plan(chosen)
        assert plan.todo == [2] and "other" in plan.stale[drive.ids[2]]
        again.run(plan)
        assert not again.plan(chosen).todo


def test_joined_maps_do_not_depend_on_what_was_built_before(street: Path, tmp_path: Path) -> None:
    drive = open_drive(street)

    def built(folder: str, *parts: Selection) -> dict[str, Depth]:
        job = build.prepare(drive, Stereo(), folder=tmp_path / folder, temporal=2)
        for part in parts:
            report = job.run(job.plan(part))
            assert not report.failed
        return {id_: job.prior.read(id_) for id_ in job.prior.ids()}

    whole = built("whole", Selection())
    parts = built("parts", Selection(frames="4:5"), Selection(shard="2/2"), Selection(shard="1/2"))
    assert whole.keys() == parts.keys() == set(drive.ids)
    for id_, depth in whole.items():
        np.testing.assert_array_equal(depth.depth_m, parts[id_].depth_m)
    own = build.prepare(drive, Stereo(), folder=tmp_path / "whole").prior
    assert own.ids() == list(drive.ids) and own.name != "whole"


def test_joined_maps_flicker_half_and_are_no_worse(street: Path, tmp_path: Path) -> None:
    drive = open_drive(street)
    joined = build.prepare(drive, Stereo(), folder=tmp_path, temporal=2).run().prior
    own = build.prepare(drive, Stereo(), folder=tmp_path).prior
    assert score_command.run([str(tmp_path), "--temporal"]) == 0
    before, after = (Result.load(prior.folder / "metrics.json").metrics() for prior in (own, joined))
    assert after["abs_rel"] <= before["abs_rel"] and after["rmse"] <= before["rmse"]
    assert after["flicker"] < 0.5 * before["flicker"]


def test_a_neighbour_that_lacks_is_left_out_and_told(own_street: Path, tmp_path: Path) -> None:
    drive = open_drive(own_street)
    next(own_street.rglob(f"image_02/data/{drive.ids[3]}.*")).write_bytes(b"no image")
    notes: list[str] = []
    job = build.prepare(open_drive(own_street), Stereo(), folder=tmp_path, temporal=1)
    report = job.run(job.plan(Selection(frames="2:4")), on_note=notes.append)
    assert list(report.failed) == [drive.ids[3]], "its own map cannot be made either"
    assert any(f"frame {drive.ids[2]}: joined without its neighbour {drive.ids[3]}: " in note for note in notes)


def test_a_drive_without_poses_cannot_be_joined(image_folder: Path, tmp_path: Path) -> None:
    (image_folder / "poses.txt").unlink()
    with pytest.raises(DataError, match="--temporal joins frames by their poses, and it has no poses"):
        build.prepare(open_drive(image_folder), Stereo(), folder=tmp_path, temporal=2)
    with pytest.raises(UsageError, match="--temporal"):
        command.run([str(image_folder), "--method", "stereo", "--temporal", "-1"])


def test_maps_of_before_have_the_chance_by_their_confidence(street: Path, tmp_path: Path) -> None:
    drive = open_drive(street)
    job = build.prepare(drive, Stereo(), folder=tmp_path)
    prior = job.run(job.plan(Selection(frames="0:1"))).prior
    now = prior.read(drive.ids[0])
    prior.write(drive.ids[0], Depth(now.depth_m, now.confidence), 0.0)
    assert prior.read(drive.ids[0]).within_5_percent is None
    derived = StoredMaps(job).read(0).within_5_percent
    assert derived is not None and now.within_5_percent is not None
    sure = (now.trust() > 0.02) & (now.trust() < 0.98)
    # The method's own was mended by another line than its own confidence: the model of errors comes near.
    assert np.abs(derived[sure] - now.within_5_percent[sure]).mean() < 0.08


def test_other_eyes_have_their_own_parts(street: Path, tmp_path: Path) -> None:
    left, right = (open_drive(street, options=DriveOptions(camera=camera)) for camera in ("image_02", "image_03"))
    folders = {build.prepare(drive, TWO, folder=tmp_path).prior.folder.parent for drive in (left, right)}
    assert len(folders) == 2
