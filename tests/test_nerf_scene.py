"""Splits and scenes: which frames train, how priors are joined, and what is refused."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nerf.prepare import SceneConfig, open_scene
from nerf.scene import Scene, view_rays
from priors import cache
from priors.cache import Prior
from priors.errors import DataError
from priors.filters import Filters
from priors.types import Camera, Depth, Drive, Frame

SIZE = (6, 8)
K = np.array([[10.0, 0, 3.5], [0, 10.0, 2.5], [0, 0, 1]])


class Corridor:
    """A drive along z, a metre a frame; every image is a ramp plus the frame's number."""

    name = "corridor"

    def __init__(self, count: int = 20, first: int = 0, print_: str = "corridor", jump_m: float = 0.0) -> None:
        self.ids = [f"{number:06d}" for number in range(first, first + count)]
        self.print_, self.jump_m = print_, jump_m

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, index: int) -> Frame:
        T_world_cam = np.eye(4)
        T_world_cam[2, 3] = index + (self.jump_m if index >= 5 else 0)
        ramp = np.arange(SIZE[0] * SIZE[1], dtype=np.uint8).reshape(SIZE) + np.uint8(index)
        image = np.repeat(ramp[..., None], 3, axis=2)
        return Frame(self.ids[index], Camera(K, SIZE), {"image": lambda: image}, T_world_cam=T_world_cam)

    def describe(self) -> dict[str, Any]:
        return {"dataset": "corridor", "path": "/nowhere"}

    def fingerprint(self) -> str:
        return self.print_


def prior(folder: Path, depths: dict[str, np.ndarray], print_: str = "corridor", method: str = "m") -> Prior:
    manifest = {
        "format": cache.FORMAT,
        "key": "0" * 10,
        "method": method,
        "drive": {"name": "corridor", "path": "/nowhere"},
    }
    made = cache.create(folder / "corridor" / "m-0", {**manifest, "fingerprint": print_})
    for id_, depth_m in depths.items():
        made.write(id_, Depth(depth_m.astype(np.float32)), 0.0)
    return made


def flat(value: float) -> np.ndarray:
    return np.full(SIZE, value)


def scene(folder: Path, drive: Drive, made: Prior | None, views: str = "dense", **options: Any) -> Scene:
    return open_scene(drive, made, SceneConfig(views, **options), folder)


def test_rays_lead_back_to_their_pixels(tmp_path: Path) -> None:
    made = scene(tmp_path, Corridor(), prior(tmp_path / "cache", {"000003": flat(7.0)}))
    frame, row, column = np.array([3, 3, 4]), np.array([0, 5, 2]), np.array([0, 7, 3])
    rays = made.rays(frame, row, column)
    np.testing.assert_array_equal(rays.origins_m[:, 2], [3, 3, 4])
    np.testing.assert_allclose(rays.directions[:, 2], 1), "the pose does not turn: camera z is world z"
    pixels = rays.directions.numpy() @ K.T
    np.testing.assert_allclose(pixels[:, 0], column, atol=1e-5)
    np.testing.assert_allclose(pixels[:, 1], row, atol=1e-5)
    assert rays.rgb is not None and rays.depth_m is not None
    np.testing.assert_allclose(rays.rgb[:, 0] * 255, [3, 50, 23], atol=1e-4)
    np.testing.assert_allclose(rays.depth_m, [7, 7, 0], err_msg="joined by id: frame 4 has no map")


def test_a_view_s_rays_are_row_by_row(tmp_path: Path) -> None:
    made = scene(tmp_path, Corridor(), None)
    rays = view_rays(made.camera, made.T_world_cam[2])
    each = made.rays(np.full(48, 2), *np.divmod(np.arange(48), 8))
    np.testing.assert_allclose(rays.directions, each.directions, atol=1e-6)
    np.testing.assert_allclose(rays.origins_m, each.origins_m)


def test_drawing_is_decided_by_seed_and_step(tmp_path: Path) -> None:
    made = scene(tmp_path, Corridor(), None, "sparse")
    one, same, other = made.draw(50, 1, 7), made.draw(50, 1, 7), made.draw(50, 1, 8)
    np.testing.assert_array_equal(one.directions, same.directions)
    assert not np.array_equal(one.directions, other.directions)
    assert set(one.origins_m[:, 2].tolist()) <= {float(position) for position in made.train}


@pytest.mark.parametrize(("method", "guessed"), [("completion", True), ("stereo", False), ("lidar", False)])
def test_a_completed_map_s_doubtful_values_are_guesses(tmp_path: Path, method: str, guessed: bool) -> None:
    assert (
        scene(tmp_path, Corridor(), prior(tmp_path / "cache", {"000003": flat(7.0)}, method=method)).guessed == guessed
    )
    assert not scene(tmp_path, Corridor(), None).guessed


def test_filters_thin_the_prior(tmp_path: Path) -> None:
    depth_m = flat(5.0)
    depth_m[:3] = 50
    made = prior(tmp_path / "cache", {"000003": depth_m})
    whole, near = (scene(tmp_path, Corridor(), made, filters=Filters(clip=c)).depth_m for c in (None, 40.0))
    assert whole is not None and near is not None
    assert (whole[3] > 0).sum() == 48 and (near[3] > 0).sum() == 24


def test_what_is_prepared_is_used_again(tmp_path: Path) -> None:
    made = prior(tmp_path / "cache", {"000004": flat(5.0)})
    scene(tmp_path, Corridor(), made)
    stamps = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.npy")}
    scene(tmp_path, Corridor(), made, "sparse")
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.npy")} == stamps


def test_a_map_that_was_made_anew_is_read_again(tmp_path: Path) -> None:
    for value in (5.0, 6.0):
        found = scene(tmp_path, Corridor(), prior(tmp_path / "cache", {"000004": flat(value)})).depth_m
        assert found is not None and (found[4] == value).all()


def test_a_killed_preparation_is_begun_again(tmp_path: Path) -> None:
    made = prior(tmp_path / "cache", {"000003": flat(5.0)})
    place = next(scene(tmp_path, Corridor(), made) and tmp_path.glob("corridor-*/m-*"))
    place.rename(place.with_name(f".{place.name}.half"))
    again = scene(tmp_path, Corridor(), made)
    assert again.depth_m is not None and (again.depth_m[3] == 5).all()


@pytest.mark.parametrize(
    ("drive", "made_for", "ids", "value", "expected"),
    [
        (Corridor(), "another", ["000003"], 5.0, "made for /nowhere"),
        (Corridor(first=100), "corridor", ["000003"], 5.0, "none of the 20 frames has a map"),
        (Corridor(), "corridor", ["000003"], 0.0, "no value in any of the 18 training frames"),
        (Corridor(), "corridor", ["000009"], 5.0, "no value in any of the 18 training frames"),
        (
            Corridor(jump_m=100),
            "corridor",
            ["000003"],
            5.0,
            "jumps 101.0 m from frame 000004 to 000005.* --frames 5:20, its longest part",
        ),
    ],
)
def test_priors_and_poses_that_do_not_fit_are_refused(
    tmp_path: Path, drive: Drive, made_for: str, ids: list[str], value: float, expected: str
) -> None:
    made = prior(tmp_path / "cache", {id_: flat(value) for id_ in ids}, made_for)
    with pytest.raises(DataError, match=expected):
        scene(tmp_path, drive, made)


@pytest.mark.parametrize(("made_for", "id_"), [("another", "000003"), ("corridor", "000050")])
def test_a_prior_that_does_not_fit_is_found_out_before_images_are_read(tmp_path: Path, made_for: str, id_: str) -> None:
    with pytest.raises(DataError):
        scene(tmp_path, Corridor(), prior(tmp_path / "cache", {id_: flat(5.0)}, made_for))
    assert not list(tmp_path.glob("corridor-*"))


def test_a_frame_without_a_pose_is_named(tmp_path: Path) -> None:
    class Lost(Corridor):
        def __getitem__(self, index: int) -> Frame:
            frame = super().__getitem__(index)
            return replace(frame, T_world_cam=None) if index == 4 else frame

    with pytest.raises(DataError, match="frame 000004 has no pose"):
        scene(tmp_path, Lost(), None)


def test_a_map_of_another_size_is_named(tmp_path: Path) -> None:
    made = prior(tmp_path / "cache", {"000003": np.full((3, 4), 5.0)})
    with pytest.raises(DataError, match=r"000003\.png"):
        scene(tmp_path, Corridor(), made)


def test_the_record_is_json(tmp_path: Path) -> None:
    scene(tmp_path, Corridor(), None)
    record = json.loads(next(tmp_path.glob("corridor-*/frames.json")).read_text())
    assert record["size"] == list(SIZE) and len(record["T_world_cam"]) == 20
