"""Which method suits a drive, and which of its priors a fit."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from factories import write_folder, write_odometry, write_raw

from eval.protocol import preset
from eval.result import Comparison, score
from priors import cache
from priors.cache import Prior
from priors.drives import open_drive
from priors.plan.choice import advise_prior, kind
from priors.plan.way import advise_method
from priors.sky import sky_mask
from priors.types import Depth, Drive

IDS = ("a", "b", "c")


@pytest.fixture
def drive(tmp_path: Path) -> Drive:
    return open_drive(write_folder(tmp_path / "mine", IDS))


def make(drive: Drive, home: Path, method: str, share: float = 1.0, **config: str) -> Prior:
    """A prior with values in this share of the columns, written as a build does."""
    name = "-".join([method, *config.values()])
    manifest = {"format": cache.FORMAT, "method": method, "key": name, "config": config, "drive": {"name": drive.name}}
    prior = cache.create(home / "cache" / drive.name / name, manifest)
    for frame in (drive[i] for i in range(len(drive))):
        depth_m = np.full(frame.camera.size, 10, np.float32)
        depth_m[:, round(share * frame.camera.size[1]) :] = 0
        prior.write(frame.id, Depth(depth_m), 0.1)
    return prior


def scored(prior: Prior, error: float, protocol: str = "paper", ids: tuple[str, ...] = IDS) -> None:
    """Keep a score with this AbsRel."""
    truth_m = np.full((4, 4), 10, np.float32)
    frames = [Comparison(id_, truth_m * np.float32(1 + error), None, truth_m) for id_ in ids]
    score(frames, preset(protocol)).save(prior.folder / "metrics.json")


def test_a_pair_asks_for_stereo(drive: Drive) -> None:
    advice = advise_method(drive)
    assert (advice.method, advice.has) == ("stereo", ("a stereo pair",))


def test_a_lidar_without_a_pair_asks_for_completion(tmp_path: Path) -> None:
    raw = write_raw(tmp_path)
    assert advise_method(open_drive(raw)).method == "stereo"
    shutil.rmtree(raw / "image_03")
    advice = advise_method(open_drive(raw))
    assert advice.method == "completion" and "LiDAR" in advice.reason
    shutil.rmtree(raw / "velodyne_points")
    assert advise_method(open_drive(raw)).method == "mono"


def test_sparse_maps_ask_for_completion(tmp_path: Path) -> None:
    mine = write_folder(tmp_path, IDS, right=False)
    assert advise_method(open_drive(mine)).method == "mono"
    (mine / "depth").rename(mine / "sparse")
    advice = advise_method(open_drive(mine))
    assert advice.method == "completion" and "sparse" in advice.reason


def test_sweeps_that_cannot_be_placed_are_no_lidar(tmp_path: Path) -> None:
    odometry = write_odometry(tmp_path)
    shutil.rmtree(odometry / "sequences" / "06" / "image_3")
    calib = odometry / "sequences" / "06" / "calib.txt"
    calib.write_text("".join(line for line in calib.open() if not line.startswith("Tr")))
    assert advise_method(open_drive(odometry)).method == "mono"


def test_what_most_frames_lack_does_not_decide(tmp_path: Path) -> None:
    mine = write_folder(tmp_path, IDS)
    for id_ in IDS[1:]:
        (mine / "right" / f"{id_}.png").unlink()
    opened = open_drive(mine)
    assert advise_method(opened).method == "mono"
    assert advise_method(opened, [0]).method == "stereo", "of the frames that were asked for"


def test_the_only_prior_is_taken_however_sparse(drive: Drive, tmp_path: Path) -> None:
    lidar = make(drive, tmp_path, "lidar", 0.2)
    assert advise_prior([lidar], drive).prior is lidar


def test_the_least_error_wins_among_the_dense(drive: Drive, tmp_path: Path) -> None:
    lidar, stereo, mono = (make(drive, tmp_path, m, s) for m, s in (("lidar", 0.5), ("stereo", 1), ("mono", 0.95)))
    for prior, error in ((lidar, 0.01), (stereo, 0.1), (mono, 0.05)):
        scored(prior, error)
    advice = advise_prior([lidar, stereo, mono], drive)
    assert advice.prior is mono and "0.0500" in advice.reason
    assert [prior for _, prior in advice.others] == [lidar, stereo]


@pytest.mark.parametrize(
    "other",
    [
        lambda prior: None,
        lambda prior: scored(prior, 0.05, "garg"),
        lambda prior: scored(prior, 0.05, ids=IDS[:1]),
        lambda prior: (prior.folder / "metrics.json").write_text("{"),
    ],
    ids=["not scored", "another protocol", "other frames", "damaged"],
)
def test_scores_that_do_not_compare_decide_nothing(drive: Drive, tmp_path: Path, other: object) -> None:
    stereo, mono = make(drive, tmp_path, "stereo"), make(drive, tmp_path, "mono")
    scored(stereo, 0.1)
    other(mono)  # type: ignore[operator]
    assert advise_prior([mono, stereo], drive).prior is stereo


def test_the_order_of_kinds(drive: Drive, tmp_path: Path) -> None:
    left = [make(drive, tmp_path, method) for method in ("lidar", "road", "mono", "completion")]
    left += [make(drive, tmp_path, "stereo", model=model) for model in ("classical", "cfnet")]
    taken = []
    while len(left) > 1:
        advice = advise_prior(left, drive)
        taken.append(kind(advice.prior))
        left.remove(advice.prior)
    assert taken == ["stereo network", "classical stereo", "completion", "mono", "lidar"]


def test_sky_is_not_to_be_covered(tmp_path: Path, street_view: SimpleNamespace) -> None:
    """A map with nothing in the sky is dense, one with nothing on as many pixels of the ground is not."""
    drive, sky = street_view.drive, street_view.sky
    assert 0.1 < sky.mean() < 0.9
    assert advise_prior([street_view.hole, street_view.skyless], drive).prior is street_view.skyless
    assert advise_prior([replace(street_view.hole), street_view.skyless], drive).reason.startswith("no other")


@pytest.fixture
def street_view(tmp_path: Path) -> SimpleNamespace:
    """A street's frame, and two priors: one lacks the sky, the better kind as much of the ground."""
    from priors.codecs import write_image

    folder = write_folder(tmp_path / "grey", ("a",), right=False)
    height, width = open_drive(folder)[0].camera.size
    image = np.zeros((height, width, 3), np.uint8)
    image[: height // 3] = (150, 190, 240)
    image[height // 3 :] = np.random.default_rng(0).integers(20, 90, (height - height // 3, width, 1))
    write_image(folder / "left" / "a.png", image)
    drive = open_drive(folder)
    sky = sky_mask(drive[0].image())
    skyless, hole = make(drive, tmp_path, "mono"), make(drive, tmp_path, "stereo")
    skyless.write("a", Depth(np.where(sky, 0, 10).astype(np.float32)), 0.1)
    hole.write("a", Depth(np.where(sky[::-1], 0, 10).astype(np.float32)), 0.1)
    return SimpleNamespace(drive=drive, sky=sky, skyless=skyless, hole=hole)


def test_frames_without_a_map_are_not_covered(drive: Drive, tmp_path: Path) -> None:
    stereo, mono = make(drive, tmp_path, "stereo"), make(drive, tmp_path, "mono")
    stereo.depth_path("c").unlink()
    assert advise_prior([stereo, mono], drive).prior is mono
    assert advise_prior([stereo, mono], drive, ["a", "b"]).prior is stereo


def test_the_densest_is_taken_where_none_is_dense(drive: Drive, tmp_path: Path) -> None:
    lidar, completion = make(drive, tmp_path, "lidar", 0.3), make(drive, tmp_path, "completion", 0.2)
    advice = advise_prior([lidar, completion], drive)
    assert advice.prior is lidar and "30%" in advice.reason


def test_recorded_densities_stand_for_images_that_are_gone(drive: Drive, tmp_path: Path) -> None:
    stereo, mono = make(drive, tmp_path, "stereo", 0.5), make(drive, tmp_path, "mono", 1)
    shutil.rmtree(tmp_path / "mine" / "left")
    assert advise_prior([stereo, mono], drive).prior is mono
    (mono.folder / "frames.jsonl").write_text(json.dumps({"id": "a"}) + "\n")
    assert advise_prior([stereo, mono], drive).prior is stereo, "what no one has recorded is not known"
