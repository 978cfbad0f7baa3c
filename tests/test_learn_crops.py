"""Packs of training crops: what comes back from disk, what fits, what stays out, what the trainings make of them."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from factories import write_raw
from layouts.kitti_stereo import write_2015
from test_learn_completion import scene, write_samples
from test_learn_data import write_street

from cli.priors import PROGRAM
from priors.errors import DataError
from priors.held_back import is_held_back
from priors.learn import lidar_scene, moment_file, pair_file, training_run
from priors.learn.completion import CompletionConfig, CompletionTask
from priors.learn.config import TrainConfig
from priors.learn.crop_pack import HELD_BACK, TRAIN, CropPack
from priors.learn.crop_packing import PackRequest, pack_crops, spread, window_of
from priors.learn.moment import Moment, Scan
from priors.learn.mono import MonoConfig, MonoTask, read_street
from priors.learn.real_moments import candidates
from priors.learn.real_truth import DRIVE, KITTI2015
from priors.learn.sample_folder import is_held_out
from priors.learn.stereo import StereoTask
from priors.learn.stereo_data import packed_mixture, packed_validation
from priors.learn.stereo_pair import crop
from priors.nets import runtime
from priors.pairs.rectification import RectificationError
from tests.reference.elsewhere import DEVICE, Away, Elsewhere

pytestmark = pytest.mark.networks


def moment(source: str = DRIVE) -> Moment:
    """A moment of a road and a box, of which a third is known and the rest matched."""
    one = scene(real=True)
    rng = np.random.default_rng(3)
    smooth = np.repeat(np.repeat(np.repeat(rng.integers(60, 200, (36, 72, 1), np.uint8), 8, 0), 8, 1), 3, 2)
    every_px = (300 * 0.54 / one.truth_m).astype(np.float32)
    true = rng.random(every_px.shape) < 0.3
    sky = np.zeros(every_px.shape, bool)
    sky[:20] = True
    nothing = np.float32(0)
    true_px, matched_px = np.where(true & ~sky, every_px, nothing), np.where(true | sky, nothing, every_px)
    scan = Scan(one.points_m, one.beam, one.T_cam_lidar, {5: np.where(true, one.truth_m, nothing)})
    error = RectificationError(0.5, 0.3, 1.1, -0.7, 0.981)
    return Moment(source, "a", smooth, smooth, one.camera, 0.54, true_px, matched_px, 0.2, sky, error, scan)


def test_a_moment_comes_back_as_exact_as_its_file_says(tmp_path: Path) -> None:
    one = moment()
    moment_file.write(tmp_path / "a.npz", one)
    again = moment_file.read(tmp_path / "a.npz")
    assert np.abs(again.true_px - one.true_px).max() <= 1 / 64
    assert np.array_equal(again.true_px > 0, one.true_px > 0) and np.array_equal(again.sky, one.sky)
    kept = again.matched_px > 0
    assert np.array_equal(kept[::2, ::2], one.matched_px[::2, ::2] > 0) and not kept[1::2].any()
    assert np.abs(again.matched_px - one.matched_px)[kept].max() <= 1 / 16
    assert (again.matched_weight, again.error, again.baseline_m) == (0.2, one.error, 0.54)
    assert np.array_equal(again.camera.K, one.camera.K) and again.camera.size == one.camera.size
    off = (again.left.astype(float) - one.left) ** 2
    assert 10 * np.log10(255**2 / off.mean()) > 30
    assert one.scan is not None and again.scan is not None
    order = np.lexsort((one.scan.points_m[:, 0] / one.scan.points_m[:, 2], one.scan.beam))
    for mine, theirs in zip(again.scan.points_m, one.scan.points_m[order], strict=True):
        assert abs(mine[2] - theirs[2]) <= 1 / 512 + 1e-4
        assert np.abs(mine[:2] / mine[2] - theirs[:2] / theirs[2]).max() * 300 <= 1 / 32 + 1e-3
    assert np.array_equal(again.scan.beam, one.scan.beam[order])
    assert np.abs(again.scan.accumulated_m[5] - one.scan.accumulated_m[5]).max() <= 1 / 512 + 1e-5


def test_a_moment_tells_each_network_the_same(tmp_path: Path) -> None:
    one = moment()
    pair, view = one.pair(), one.view()
    assert set(np.unique(pair.weight)) == {np.float32(0.2), 1}
    assert (pair.weight[one.true_px > 0] == 1).all() and (pair.disparity_px[one.sky] == 0).all()
    promised_px = one.error.correct(one.true_px, one.camera)
    truth_m = np.where(one.true_px > 0, 300 * 0.54 / promised_px, 0)
    np.testing.assert_allclose(one.scene().truth_m, truth_m, rtol=1e-5)
    np.testing.assert_allclose(view.depth_m, truth_m, rtol=1e-5)
    assert (view.sky[one.sky] == 1).all() and (view.sky[one.true_px > 0] == 0).all()
    part = one.cut(30, 100, (64, 128))
    np.testing.assert_allclose(part.view().depth_m, view.depth_m[30:94, 100:228], rtol=1e-5)
    assert part.scan is not None and 0 < len(part.scan.points_m) < len(scene().points_m)
    with pytest.raises(DataError, match="one eye"):
        replace(one, right=None).pair()
    with pytest.raises(DataError, match="no sweep"):
        replace(one, scan=None).scene()


def test_a_packed_sample_is_what_the_folder_holds(tmp_path: Path) -> None:
    street = write_samples(tmp_path)
    (one,) = [c for c in candidates(None, street)[0] if c.name == "000001"]
    made = window_of(one.make(), middle=True)
    path = street / "000001.npz"
    rendered, sample = lidar_scene.read_street(path), pair_file.read(path)
    assert np.array_equal(made.pair().disparity_px, sample.disparity_px)
    assert np.array_equal(made.scene().truth_m, rendered.truth_m) and not made.scene().real
    assert len(made.scene().points_m) == len(rendered.points_m)
    assert np.array_equal(made.view().depth_m, read_street(path).depth_m)
    assert np.array_equal(made.view().sky, read_street(path).sky)


def real_data(folder: Path) -> Path:
    """Two pairs of KITTI 2015, of which one is held back, and a drive 0009 of which three frames are."""
    split = write_2015(folder / "kitti_stereo2015", sweeps=True)
    for path in sorted(split.rglob("000001*")):
        path.rename(path.with_name(path.name.replace("000001", "000125")))
    write_raw(folder / "kitti_raw_train", range(23, 29))
    return folder


def test_what_is_held_back_is_never_packed_for_training(tmp_path: Path) -> None:
    request = PackRequest(tmp_path / "pack", write_street(tmp_path / "street"), real_data(tmp_path / "data"), 36)
    counts = pack_crops(request)
    pack = CropPack(request.out)
    assert counts == {"kitti2015": 1, "drive0009": 3, "street": 6, HELD_BACK: 6}
    drives = {KITTI2015: "kitti_stereo2015_training", DRIVE: "2011_09_26_drive_0009_sync"}
    for part, held in ((pack.train, False), (pack.held_back, True)):
        for source, drive in drives.items():
            assert part[source] and all(is_held_back(drive, one.name) == held for one in part[source])
        assert all(is_held_out(Path(one.name)) == held for one in part["street"])
    pairs = packed_validation(pack)
    assert {pair.source for pair in pairs} == {KITTI2015, DRIVE, "street"}
    draw = packed_mixture(pack, (48, 96))
    first, again = draw(np.random.default_rng(4)), draw(np.random.default_rng(4))
    assert first.left.shape[:2] == (48, 96) and np.array_equal(first.left, again.left)
    assert {draw(np.random.default_rng([1, step])).source for step in range(40)} == {KITTI2015, DRIVE, "street"}


def test_a_pack_keeps_to_its_room_and_goes_on(tmp_path: Path) -> None:
    street = write_street(tmp_path / "street", worlds=8)
    whole = PackRequest(tmp_path / "pack", street, None, 36)
    pack_crops(whole)
    record = json.loads((whole.out / "pack.json").read_text())
    assert record["crops"] == {HELD_BACK: 2, "street": 14}
    files = {path: path.stat().st_mtime_ns for path in whole.out.rglob("*.npz")}
    assert sum(path.stat().st_size for path in files) == record["bytes"]
    next(iter(files)).unlink()
    pack_crops(whole)
    assert set(whole.out.rglob("*.npz")) == set(files)
    assert sum(path.stat().st_mtime_ns != made for path, made in files.items()) == 1, "the others are not made again"
    half = replace(whole, mib=(record["bytes"] / 2 + 4096) / 2**20)
    pack_crops(half)
    left = list(half.out.rglob("*.npz"))
    assert 3 < len(left) < len(files) and sum(path.stat().st_size for path in left) < record["bytes"] / 2
    with pytest.raises(DataError, match=r"--mib 0.01: no room for crops of all sources"):
        pack_crops(replace(whole, mib=0.01))
    with pytest.raises(DataError, match="no whole pack of crops"):
        CropPack(whole.out)


def test_the_first_of_a_spread_order_lie_evenly() -> None:
    for count in (1, 2, 7, 65, 100):
        order = list(spread(count))
        assert sorted(order) == list(range(count))
    assert max(np.diff(sorted([*spread(64)][:16]))) == 4


def test_completion_and_mono_learn_from_a_pack(tmp_path: Path) -> None:
    pack = tmp_path / "pack"
    pack_crops(PackRequest(pack, write_samples(tmp_path), None, 36))
    moment_file.write(pack / TRAIN / "drive0009_a.npz", moment())
    moment_file.write(pack / HELD_BACK / "drive0009_b.npz", moment())
    tasks = [
        CompletionTask(CompletionConfig(crops=pack, batch=6, size="s")),
        MonoTask(MonoConfig(crops=pack, batch=2, size="s")),
    ]
    for task in tasks:
        first, again = (task.batch(3, np.random.default_rng([0, 3])) for _ in range(2))
        assert all(torch.equal(first[name], again[name]) for name in first)
        assert all(torch.isfinite(value).all() for value in first.values())
    assert set(tasks[0].held_back()) == {"street_64lines", "drive0009_64lines"}  # type: ignore[union-attr]


def test_the_command_says_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    street = write_street(tmp_path / "street")
    train = ["train", "stereo", str(tmp_path / "run"), "--crops", str(tmp_path / "none")]
    assert PROGRAM.run(train) == 1
    assert "no whole pack of crops in it: make it with priors train pack-crops" in capsys.readouterr().err
    assert PROGRAM.run([*train, "--real", str(tmp_path)]) == 2
    assert "stands in place of --real" in capsys.readouterr().err
    assert PROGRAM.run(["train", "pack-crops", str(tmp_path / "pack"), "--street", str(street), "--mib", "nan"]) == 2
    assert "--mib nan: expected more than 0" in capsys.readouterr().err
    assert PROGRAM.run(["train", "pack-crops", str(tmp_path / "pack"), "--street", str(street)]) == 0
    path = next((tmp_path / "pack" / TRAIN).glob("*.npz"))
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(DataError, match=f"{path.name}: damaged crop"):
        CropPack(tmp_path / "pack")


@pytest.mark.parametrize("net", ["cfnet", "mffnet", "bts"])
def test_a_training_stays_on_its_device(net: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A step and a validation elsewhere (tests/reference/elsewhere.py), where nothing of the CPU may get among them.

    Torch knows neither bf16 nor AdamW's fused step nor its inference mode there: they are exchanged.
    """
    autocast = torch.autocast
    monkeypatch.setattr(torch, "autocast", lambda kind, *rest, **named: autocast("cpu", *rest, **named))
    monkeypatch.setattr(torch, "inference_mode", torch.no_grad)
    monkeypatch.setattr(training_run, "NORM_BATCHES", 1)
    plain = partial(torch.optim.SGD, lr=1e-4, foreach=False)
    monkeypatch.setattr(training_run, "make_optimiser", lambda net, config: plain(net.parameters()))
    pack_crops(PackRequest(tmp_path / "pack", write_samples(tmp_path), None, 36))
    task = small_task(net, tmp_path / "pack")
    with Elsewhere():
        run = training_run.TrainingRun(task, tmp_path / "run", TrainConfig(steps=1), {"net": net}, str(DEVICE))
        run.advance(task.batch(0, np.random.default_rng(0)))
        run.validate()
        run.save()
    assert all(isinstance(x, Away) for x in run.net.parameters())
    assert np.isfinite(list(run.validation.values())).all() and run.validation["error"] > 0


def small_task(net: str, pack: Path) -> training_run.Task:
    """A network that learns from single crops of a pack."""
    if net == "mffnet":
        return CompletionTask(CompletionConfig(crops=pack, batch=1, size="s"))
    if net == "bts":
        return MonoTask(MonoConfig(crops=pack, batch=1, size="s", imagenet=False))
    crops = CropPack(pack)
    held_back = [crop(pair, 100, 100, (64, 128)) for pair in packed_validation(crops)]
    return StereoTask(runtime.create(net, "s"), packed_mixture(crops, (64, 128)), held_back, 1, (0, 0))
