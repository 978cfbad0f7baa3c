"""The pool: every task once, exceptions arrive, and the libraries' threads are held and let go."""

import os
import subprocess
import sys
import threading
import time
import weakref
from collections import Counter
from pathlib import Path

import cv2
import pytest
import torch
from threadpoolctl import threadpool_info

from cli.arguments import ThreadArguments
from priors.errors import DataError
from priors.machine import threads

ROOT = Path(__file__).resolve().parents[1]
COUNTS = (1, 2, 5)


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("tasks", [0, 1, 2, 3, 1000])
def test_every_task_is_done_once(count: int, tasks: int) -> None:
    done: list[int] = []
    with threads.limited(count):
        threads.run(tasks, done.append)
    assert Counter(done) == Counter(range(tasks))


def test_calls_from_several_threads_do_not_mix() -> None:
    found: dict[int, list[int]] = {}

    def call(number: int) -> None:
        found[number] = []
        threads.run(200, lambda task: found[number].append(task))

    with threads.limited(4):
        callers = [threading.Thread(target=call, args=(number,)) for number in range(6)]
        for caller in callers:
            caller.start()
        for caller in callers:
            caller.join()
    assert all(sorted(tasks) == list(range(200)) for tasks in found.values())


def test_a_helper_that_wakes_late_holds_nothing() -> None:
    """It would free the caller's tensors, and abort the process where that is ending."""

    class Work:
        def __call__(self, task: int) -> None:
            pass

    begun, late = threading.Barrier(3, timeout=20), threading.Event()

    def occupy(task: int) -> None:
        begun.wait()
        late.wait(20)

    with threads.limited(2):
        other = threading.Thread(target=threads.run, args=(2, occupy))
        other.start()
        begun.wait()  # the only helper is busy from here on
        work = Work()
        gone = weakref.ref(work)
        threads.run(2, work)
        del work
        assert gone() is None
        late.set()
        other.join()


def test_tasks_run_at_the_same_time() -> None:
    meeting = threading.Barrier(3, timeout=20)
    with threads.limited(3):
        threads.run(3, lambda task: meeting.wait())  # would break if one thread had to do two


@pytest.mark.parametrize("count", COUNTS)
def test_an_exception_reaches_the_caller_and_the_pool_works_on(count: int) -> None:
    def work(task: int) -> None:
        if task == 7:
            raise ValueError("task 7")

    with threads.limited(count):
        with pytest.raises(ValueError, match="task 7"):
            threads.run(50, work)
        done: list[int] = []
        threads.run(50, done.append)
    assert sorted(done) == list(range(50))


def test_a_task_may_run_tasks() -> None:
    done: list[tuple[int, int]] = []
    with threads.limited(3):
        threads.run(8, lambda outer: threads.run(8, lambda inner: done.append((outer, inner))))
    assert sorted(done) == [(outer, inner) for outer in range(8) for inner in range(8)]


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("total", [0, 1, 63, 64, 65, 1000])
@pytest.mark.parametrize("block", [1, 64])
def test_stretches_cover_everything_and_begin_at_blocks(count: int, total: int, block: int) -> None:
    with threads.limited(count):
        parts = threads.stretches(total, block)
    assert [n for first, last in parts for n in range(first, last)] == list(range(total))
    assert all(first % block == 0 for first, _ in parts)


def test_what_is_small_is_one_task_and_what_is_large_many() -> None:
    with threads.limited(3):
        assert len(threads.stretches(10, threads.worth(100))) == 1
        assert len(threads.stretches(10_000, threads.worth(10_000))) == 12


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_process_has_a_pool_of_its_own() -> None:
    code = """
import os
from priors.machine import threads
done = []
with threads.limited(3):
    threads.run(100, done.append)
    child = os.fork()
    found = []
    threads.run(100, found.append)
    if child == 0:
        os._exit(0 if sorted(found) == list(range(100)) else 1)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.strip() == "0"


def settings() -> tuple[object, ...]:
    blas = [(info["filepath"], info["num_threads"]) for info in threadpool_info() if info["user_api"] == "blas"]
    return threads.count(), torch.get_num_threads(), cv2.getNumThreads(), blas, os.environ.get("OMP_NUM_THREADS")


def test_limited_holds_everybody_and_lets_go() -> None:
    before = settings()
    with threads.limited(3):
        assert (threads.count(), torch.get_num_threads(), cv2.getNumThreads()) == (3, 3, 3)
        assert all(info["num_threads"] == 1 for info in threadpool_info() if info["user_api"] == "blas")
        with threads.limited(1):
            assert (threads.count(), torch.get_num_threads(), cv2.getNumThreads()) == (1, 1, 1)
            with threads.limited(None):
                assert threads.count() == 1
        assert (threads.count(), torch.get_num_threads(), cv2.getNumThreads()) == (3, 3, 3)
    assert settings() == before
    with pytest.raises(ValueError, match="inside"), threads.limited(2):
        raise ValueError("inside")
    assert settings() == before


@pytest.mark.parametrize("wrong", [0, -1])
def test_limited_wants_one_or_more(wrong: int) -> None:
    with pytest.raises(DataError, match=f"1 thread or more, found {wrong}"), threads.limited(wrong):
        pass


def test_a_library_that_loads_later_is_held_too() -> None:
    code = """
from priors.machine import threads
with threads.limited(1):
    import torch
    inside = torch.get_num_threads()
print(inside, torch.get_num_threads() == threads.available())
"""
    environment = {name: value for name, value in os.environ.items() if name != "OMP_NUM_THREADS"}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["1", "True"]


def test_a_command_that_is_not_told_uses_every_core_or_what_openmp_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    for told, expected in (("", threads.available()), ("0", threads.available()), ("3", 3)):
        monkeypatch.setenv("OMP_NUM_THREADS", told)
        with ThreadArguments().limited():
            assert (threads.count(), torch.get_num_threads(), cv2.getNumThreads()) == (expected, expected, expected)


def test_no_more_threads_run_than_were_asked_for() -> None:
    seen: set[int] = set()

    def work(task: int) -> None:
        seen.add(threading.get_ident())
        time.sleep(0.001)

    with threads.limited(5):
        threads.run(20, lambda task: time.sleep(0.001))  # the pool has grown
    with threads.limited(2):
        threads.run(100, work)
    assert len(seen) <= 2


@pytest.mark.parametrize(
    "command",
    [
        ["priors", "build", "x", "--method", "stereo"],
        ["nerf", "fit", "x"],
        ["nerf", "eval", "x"],
        ["nerf", "render", "x"],
        ["nerf", "video", "x"],
        ["nerf", "study", "x"],
    ],
    ids=" ".join,
)
def test_commands_want_one_thread_or_more(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    from cli import nerf, priors

    program = {"priors": priors.PROGRAM, "nerf": nerf.PROGRAM}[command[0]]
    assert program.run([*command[1:], "--threads", "0"]) == 2
    assert capsys.readouterr().err.strip() == "error: --threads 0: expected a whole number from 1 to 1024"


def test_a_command_uses_as_many_threads_as_it_is_told(
    raw_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from cli.priors import PROGRAM
    from priors import build

    seen: list[tuple[int, int]] = []
    original = build.Job.run

    def spy(*args: object, **kwargs: object) -> object:
        seen.append((threads.count(), cv2.getNumThreads()))
        return original(*args, **kwargs)  # type: ignore[arg-type]

    monkeypatch.setattr(build.Job, "run", spy)
    before = settings()[:3]
    arguments = ["build", str(raw_drive), "--method", "lidar", "--cache", str(tmp_path / "cache"), "--threads", "3"]
    assert PROGRAM.run(arguments) == 0
    assert seen == [(3, 3)]
    assert settings()[:3] == before


def answers() -> list[torch.Tensor]:
    """What kernels make of the same random inputs: images, features, logits."""
    import numpy as np

    from priors.nets import matching, stereo_input, upsample
    from priors.nets.confidence import is_hidden
    from priors.sky import sky_mask

    generator, rng = torch.Generator().manual_seed(0), np.random.default_rng(0)
    left, right = (torch.randn(1, 16, 60, 90, generator=generator).bfloat16() for _ in range(2))
    disparity_px = torch.randn(1, 60, 90, 6, generator=generator) * 5 + 4
    logits = torch.randn(1, 144, 60, 90, generator=generator)
    image = rng.integers(0, 256, (240, 360, 3), dtype=np.uint8)
    image[:80] = 250
    pixels = torch.from_numpy(image).permute(2, 0, 1)[None]
    with torch.inference_mode():
        return [
            torch.from_numpy(sky_mask(image)),
            torch.from_numpy(is_hidden(disparity_px[0, :, :, 0].numpy())),
            matching.lookup(left, right, disparity_px, 4),
            matching.lookup_beside([left.permute(0, 2, 3, 1)], left, right, disparity_px, 4, [disparity_px]),
            *matching.expect(disparity_px, torch.arange(6.0)[None, None, None], 2),
            upsample.convex(disparity_px[:, :, :, :2].permute(0, 3, 1, 2), logits, 4),
            *stereo_input.preprocess(pixels, pixels.flip(3), torch.bfloat16),
        ]


def test_results_do_not_depend_on_the_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    with threads.limited(1):
        expected = answers()
    assert expected[0].any()
    assert not expected[0].all()
    monkeypatch.setattr(threads, "TASK_NS", 1_000)  # as many tasks as there can be
    for count in (2, 7):
        with threads.limited(count):
            found = answers()
        assert all(torch.equal(mine, theirs) for mine, theirs in zip(found, expected, strict=True))
