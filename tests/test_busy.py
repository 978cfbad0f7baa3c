"""Beside a process that burns a core, two threads take no more CPU time than one: nobody spins while another works."""

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
import torch

from nerf.field import Field, FieldConfig
from nerf.types import Samples
from priors.machine import threads
from priors.nets import runtime

pytestmark = pytest.mark.skipif(threads.available() < 2, reason="one core: there is nothing to share")
ROUNDS = 9
SLACK = 2.0
"""Two threads that share the work count a few per cent more; torch's own, which spin, counted 22 times as much."""


@contextmanager
def burning() -> Iterator[None]:
    process = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        time.sleep(0.2)
        yield
    finally:
        process.kill()
        process.wait()


def cpu_seconds(work: Callable[[], object]) -> dict[int, float]:
    """Return the median CPU time of one and of two threads, in turns: it is the same whatever else the machine does."""
    found: dict[int, list[float]] = {1: [], 2: []}
    for _ in range(ROUNDS):
        for count, seconds in found.items():
            with threads.limited(count):
                start = time.process_time()
                work()
                seconds.append(time.process_time() - start)
    return {count: statistics.median(seconds) for count, seconds in found.items()}


def nobody_spins(work: Callable[[], object]) -> None:
    with burning():
        seconds = cpu_seconds(work)
    assert seconds[2] < SLACK * seconds[1], seconds


def test_a_step_of_a_field() -> None:
    count, rays = 16384, 512
    generator = torch.Generator().manual_seed(0)
    flat, ray = torch.zeros(count), torch.arange(count, dtype=torch.int32) * rays // count
    u, table = torch.rand(count, 3, generator=generator), torch.zeros(count, dtype=torch.int32)
    samples = Samples(torch.arange(rays + 1) * (count // rays), ray, flat, flat, flat, flat, u, table, count)
    units = torch.nn.functional.normalize(torch.randn(rays, 3, generator=generator), dim=-1)
    field = Field(FieldConfig())

    @threads.quiet()
    def step() -> None:
        field.forward(samples, units)
        field.backward(flat, torch.zeros(count, 3))

    step()  # compiles
    nobody_spins(step)


def test_a_network() -> None:
    net = runtime.open_net("cfnet", "s", runtime.choose("auto", net="cfnet"))
    left, right = torch.rand(2, 1, 3, 192, 640, generator=torch.Generator().manual_seed(0))

    def match() -> None:
        net(left, right, largest_px=64)

    match()
    nobody_spins(match)


HELD_BEFORE = """
import statistics, sys, time, torch
torch.set_num_threads(1)  # before our first call
from priors.machine import threads

def work():
    x = torch.ones(256, 256)
    for _ in range(100):
        torch.relu(x @ x).exp().sum().item()
        sum(range(2000))

def cpu_seconds(count):
    with threads.limited(count):
        start = time.process_time()
        work()
        return time.process_time() - start

cpu_seconds(2)
print(*(statistics.median(cpu_seconds(count) for _ in range(9)) for count in (1, 2)))
"""


def test_a_program_that_held_torch_to_one_thread_before() -> None:
    # The commands set the variable; a program of one's own does not.
    alone = {name: value for name, value in os.environ.items() if name != "OMP_WAIT_POLICY"}
    with burning():
        done = subprocess.run(
            [sys.executable, "-c", HELD_BEFORE], check=True, capture_output=True, text=True, env=alone
        )
    one, two = map(float, done.stdout.split())
    assert two < SLACK * one, (one, two)
