"""A street with a corner: it turns by 90 degrees, nothing folds or cracks, and its truth and poses are exact."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nerf.config import FitConfig, ModelConfig
from nerf.fields import names
from nerf.prepare import SceneConfig
from nerf.run import begin
from priors import build, geometry
from priors.drives import open_drive
from priors.drives._oxts import Track
from priors.errors import DataError
from priors.methods.lidar import Lidar
from priors.street import corner, kitti, rig
from priors.street.config import StreetConfig
from priors.street.corner import CornerPath, with_corner
from priors.street.path import Ego
from priors.street.street import Street
from priors.street.write import Asked, write_drive

SIZE = (48, 160)
TURNS = (1, -1)


@pytest.fixture(scope="module", params=[1, pytest.param(-1, marks=pytest.mark.slow)])
def street(request: pytest.FixtureRequest) -> Street:
    return Street(3, config=with_corner(StreetConfig.draw(3, 20.0), request.param))


def path_of(seed: int, turn: int) -> CornerPath:
    return CornerPath(with_corner(StreetConfig.draw(seed), turn))


@given(st.integers(0, 10_000), st.sampled_from(TURNS), st.floats(-50, 300), st.floats(-9, 9))
@settings(max_examples=20, deadline=None)
def test_places_beside_the_centre_line_are_found_again(seed: int, turn: int, s: float, t: float) -> None:
    path = path_of(seed, turn)
    place = path.bend(np.array([[s, t, 0.0]]))
    found_s, found_t, z = path.locate(place[:, 0], place[:, 1])
    assert (found_s[0], found_t[0], z[0]) == pytest.approx((s, t, 0), abs=0.02)


@pytest.mark.parametrize("turn", TURNS)
def test_the_street_runs_along_x_turns_on_a_circle_and_runs_along_y(turn: int) -> None:
    path = path_of(7, turn)
    s = np.linspace(-20, 60, 200)
    x, y, z = path.centre(s)
    around = (s > corner.BEGIN_M) & (s < corner.END_M)
    off_m = np.hypot(x - corner.BEGIN_M, y - turn * corner.RADIUS_M)[around]
    np.testing.assert_allclose(off_m, corner.RADIUS_M, atol=0.01)
    np.testing.assert_allclose(y[s < corner.BEGIN_M], 0, atol=1e-6)
    np.testing.assert_allclose(x[s > corner.END_M + 1], corner.BEGIN_M + corner.RADIUS_M, atol=0.01)
    assert not z.any() and (turn * np.diff(y) >= -1e-9).all()


@given(st.integers(0, 10_000), st.sampled_from(TURNS))
@settings(max_examples=20, deadline=None)
def test_forty_frames_turn_by_90_degrees_as_a_car_does(seed: int, turn: int) -> None:
    config = with_corner(StreetConfig.draw(seed), turn)
    poses = Ego(config, CornerPath(config)).T_world_rig(np.arange(0, 4, 0.1))
    yaw = np.unwrap(np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))
    assert turn * np.degrees(yaw[-1] - yaw[0]) == pytest.approx(90, abs=6)
    assert np.degrees(np.abs(np.diff(yaw))).max() < 5, "50 degrees a second"
    steps_m = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    assert steps_m.min() > 0.3 and steps_m.max() < 0.95


def test_what_oxts_says_of_the_turn_is_read_back(tmp_path: Path) -> None:
    config = with_corner(StreetConfig.draw(7), 1)
    poses = Ego(config, CornerPath(config)).T_world_rig(np.arange(0, 4, 0.1))
    (tmp_path / "data").mkdir()
    for number, line in enumerate(kitti.oxts_lines(poses, config.speed_mps)):
        (tmp_path / "data" / f"{number:010d}.txt").write_text(line)
    (tmp_path / "timestamps.txt").write_text(kitti.timestamps(np.arange(0, 4, 0.1)))
    track = Track(tmp_path)
    read = np.array([track.T_world_imu(f"{number:010d}") for number in range(40)])
    np.testing.assert_allclose(read, geometry.invert(poses[0]) @ poses, atol=1e-4)


@pytest.mark.parametrize("time_s", [0.6, 2.4])
def test_the_ground_has_no_crack_and_depth_is_that_of_any_other_view(street: Street, time_s: float) -> None:
    camera, now = rig.camera(SIZE), street.T_world_cam(time_s)
    view = street.view(now, camera, 0.0)
    assert (view.depth_m > 0)[SIZE[0] // 2 :].all(), "what is below the horizon is hit"
    xyz_m = geometry.transform(now, geometry.unproject(camera, view.depth_m).astype(np.float64))
    other = street.T_world_cam(time_s + 0.3)[:3, 3]
    hits = street.caster.cast(other[None].astype(np.float32), (xyz_m - other).astype(np.float32), 0.0)
    assert np.mean(hits.distance < 1.001) > 0.99, "the place is there, or something hides it"
    assert np.mean(np.abs(hits.distance - 1) < 0.001) > 0.6


def test_the_view_ahead_is_closed_by_houses(street: Street) -> None:
    ahead_m = street.view(street.T_world_cam(0.0), rig.camera(SIZE), 0.0).depth_m[SIZE[0] // 3, SIZE[1] // 2]
    assert 15 < ahead_m < 45


def test_a_drive_says_what_it_is(tmp_path: Path) -> None:
    asked = Asked(1, 7, (16, 32), "right")
    assert asked.name == "street_0007_right_sync" and asked.record()["corner"] == "right"
    plain = Asked(1, 7, (16, 32))
    assert (plain.name, plain.record().keys()) == ("street_0007_sync", {"version", "seed", "frames", "size"})
    record = tmp_path / "street" / asked.name / "street.json"
    record.parent.mkdir(parents=True)
    record.write_text(json.dumps({**asked.record(), "corner": "left"}))
    with pytest.raises(DataError, match="holds another street"):
        write_drive(tmp_path, asked)


@pytest.mark.slow
@pytest.mark.parametrize("family", names())
def test_every_family_fits_a_drive_that_turns(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, family: str
) -> None:
    home = tmp_path_factory.getbasetemp() / "turning"
    drive = open_drive(write_drive(home, Asked(40, 7, (32, 96), "left"), workers=2))
    prior = build.prepare(drive, Lidar(), folder=home / "cache").run().prior
    run = begin(
        drive, prior, SceneConfig("dense"), FitConfig(ModelConfig(family), steps=60, rays=512), tmp_path / "run"
    )
    run.fit("cpu")
    figures = run.report("cpu").metrics()
    assert figures["psnr"] > 12 and figures["abs_rel"] < 0.5
