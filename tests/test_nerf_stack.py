"""Stacks: what is read is what was written, from a map or without one, and a writer that fails leaves nothing."""

import os
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from conftest import FullDisk
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from eval.files import STALE_S
from nerf import stack
from nerf.stack import Stack, StackWriter

AROUND = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=40, deadline=None)


def written(path: Path, array: np.ndarray) -> Stack:
    with StackWriter(path, array.shape, array.dtype) as file:
        for frame in array:
            file.add(frame)
    return Stack(path)


@AROUND
@given(data=st.data(), channels=st.sampled_from([(), (1,), (3,)]), kind=st.sampled_from(["u1", "<f4"]))
@pytest.mark.parametrize("mapped", [True, False])
def test_frames_and_pixels_are_the_array_s(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    data: st.DataObject,
    channels: tuple[int, ...],
    kind: str,
    mapped: bool,
) -> None:
    monkeypatch.setattr(stack, "SMALL_BYTES", 2**20 if mapped else 0)
    shape = (data.draw(st.integers(1, 4)), data.draw(st.integers(1, 5)), data.draw(st.integers(1, 6)), *channels)
    array = np.random.default_rng(0).integers(0, 255, shape).astype(kind)
    made = written(tmp_path / "a.npy", array)
    assert made.shape == shape and len(made) == shape[0]
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), array)
    for i in range(-shape[0], shape[0]):
        np.testing.assert_array_equal(made[i], array[i])
    places = tuple(np.array(data.draw(st.lists(st.integers(0, n - 1), min_size=3, max_size=3))) for n in shape[:3])
    np.testing.assert_array_equal(made[places], array[places])
    with pytest.raises(IndexError):
        made[shape[0]]


def test_a_frame_may_be_one_value(tmp_path: Path) -> None:
    with StackWriter(tmp_path / "a.npy", (2, 3, 4), np.float32) as file:
        file.add(0)
        file.add(np.full((3, 4), 2.5))
    np.testing.assert_array_equal(Stack(tmp_path / "a.npy")[1], np.full((3, 4), 2.5, np.float32))
    assert not Stack(tmp_path / "a.npy")[0].any()


def test_a_writer_that_fails_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    written(path, np.ones((2, 3, 4), np.uint8))
    with suppress(KeyboardInterrupt), StackWriter(path, (2, 3, 4), np.uint8) as file:
        file.add(7)
        raise KeyboardInterrupt
    with pytest.raises(ValueError, match="1 of 2 frames"), StackWriter(path, (2, 3, 4), np.uint8) as file:
        file.add(7)
    assert Stack(path)[1].all() and Stack(path)[0].max() == 1
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("room", [50, 100_000])
def test_a_full_disk_is_an_error_that_names_the_file(tmp_path: Path, full_disk: FullDisk, room: int) -> None:
    path = tmp_path / "a.npy"
    with full_disk(room), pytest.raises(OSError) as told, StackWriter(path, (9, 100, 200), np.uint8) as file:
        for _ in range(9):
            file.add(1)
    assert told.value.filename == str(path) and told.value.strerror
    assert not list(tmp_path.iterdir())


def test_what_a_kill_left_behind_is_dropped_once_it_is_old(tmp_path: Path) -> None:
    old, young = tmp_path / ".a.npy.1.aa", tmp_path / ".a.npy.2.bb"
    for path in (old, young):
        path.write_bytes(b"half")
    os.utime(old, (0, time.time() - 2 * STALE_S))
    written(tmp_path / "a.npy", np.ones((1, 2, 2), np.uint8))
    assert sorted(path.name for path in tmp_path.iterdir()) == [young.name, "a.npy"]
