"""Runtimes: every network in bf16, fp32, int8 and onnxruntime, on every kind of CPU that this machine can stand in for.

    python tests/bench/bench_runtimes.py
    python tests/bench/bench_runtimes.py --write --machine "2 cores of AMD EPYC (Zen 4)"
    python tests/bench/bench_runtimes.py --processor-time --nets cfnet --rounds 5

Each kind runs in its own process, held down by ROADPRIOR_CPU (priors/machine/cpu.py). Methods run in turn with OpenCV's
3-way SGBM at 192 disparities, on one pair in memory; a figure is the median over pairs of runs that stood side by side.
--processor-time is for a machine that others use: one thread each, and its processor's time instead of the clock's.
--write puts the table where `--runtime auto` reads it: priors/nets/speeds.json. A kind that is not this machine's own
is marked: its instructions are real, its caches and clock are this machine's. onnxruntime cannot be held down: it uses
AVX-512 where the CPU has it and bf16 nowhere, so that its time counts for both kinds with AVX-512 and for no other.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from eval.files import write_bytes

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the commands have it

import cv2
import numpy as np

from priors.bench.baselines import Sgbm
from priors.drives import DriveOptions, open_drive
from priors.machine import cpu
from priors.machine.memory import keep_freed
from priors.methods.completion import Completion
from priors.methods.mono import Mono
from priors.methods.stereo import Stereo
from priors.nets import int8, speeds
from priors.nets.fused import available
from priors.pairs.rectification import NONE
from priors.types import Frame

SHARED = Path(__file__).resolve().parents[3] / "shared"
DRIVE = SHARED / "data/kitti_raw_train/2011_09_26/2011_09_26_drive_0009_sync"
NETS = {"cfnet": "s", "pcwnet": "s", "bts": "m", "mffnet": "s"}
RUNTIMES = ("bf16", "fp32", "int8", "onnx")


def main() -> None:
    """Print the table; write it."""
    options = parse()
    if options.here:
        print(json.dumps(measure(options)))
        return
    modes: dict[str, Any] = {}
    print("| CPU | network | SGBM ms | bf16 | fp32 | int8 | onnx |\n|---|---|---:|---:|---:|---:|---:|")
    for mode in options.modes or [mode for mode in cpu.supported() if mode != "amx_emulated"]:
        own = mode == cpu.supported()[0]
        found = in_process(mode, options)
        modes[mode] = {"measured": "natively" if own else "held down", "ratios": found["ratios"]}
        for net, ratios in found["ratios"].items():
            cells = " | ".join(f"{ratios[runtime]:.2f}" if runtime in ratios else "-" for runtime in RUNTIMES)
            print(f"| {mode}{'' if own else ' (held down)'} | {net} | {found['sgbm_ms']:.0f} | {cells} |", flush=True)
        if options.write:
            write(options, modes)


def write(options: argparse.Namespace, modes: dict[str, Any]) -> None:
    """Put the kinds measured so far where `--runtime auto` reads them."""
    clocked = "processor's time of one thread" if options.processor_time else "time on all cores"
    table = {"machine": options.machine, "what": f"{clocked}, SGBM's = 1", "modes": modes}
    write_bytes(speeds.FILE, (json.dumps(table, indent=1) + "\n").encode())


def parse() -> argparse.Namespace:
    """Read the flags."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DRIVE, help="a drive with pairs and sweeps")
    parser.add_argument("--frame", type=int, default=30)
    parser.add_argument("--rounds", type=int, default=9, help="timings of each")
    parser.add_argument("--nets", nargs="+", default=list(NETS), choices=list(NETS))
    parser.add_argument("--modes", nargs="+", help="kinds to measure; default: all that this machine can stand in for")
    parser.add_argument("--processor-time", action="store_true", help="one thread each, its processor's time")
    parser.add_argument("--write", action="store_true", help="write the table that auto reads")
    parser.add_argument("--machine", default="unnamed", help="what the table says it was measured on")
    parser.add_argument("--here", action="store_true", help="measure this process's kind only, print JSON")
    return parser.parse_args()


def in_process(mode: str, options: argparse.Namespace) -> dict[str, Any]:
    """Measure a kind in a process of its own."""
    own = ["--data", str(options.data), "--frame", str(options.frame), "--rounds", str(options.rounds)]
    own += ["--nets", *options.nets, *(["--processor-time"] if options.processor_time else [])]
    command = [sys.executable, __file__, "--here", *own]
    alone = {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"} if options.processor_time else {}
    environment = {**os.environ, **alone, cpu.VARIABLE: mode}  # threads that wait for each other burn processor time
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, env=environment)
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Return SGBM's milliseconds and each network's times over it, after one run each that is not counted."""
    import torch

    cpu.hold_down()
    keep_freed()
    if options.processor_time:  # before anything has run on more: idle threads of OpenMP burn processor time
        torch.set_num_threads(1)
        cv2.setNumThreads(1)
    frame = in_memory(open_drive(options.data, options=DriveOptions())[options.frame])
    counted = [(net, how) for net in options.nets for how in RUNTIMES if counts(net, how, torch.bfloat16)]
    runs = {(net, how): method(net, how, frame) for net, how in counted}
    now = time.process_time if options.processor_time else time.perf_counter
    seconds: dict[Any, list[float]] = {key: [] for key in ("sgbm", *runs)}
    peer = Sgbm(max_disparity_px=192, offset_px=NONE.offset_px)
    theirs_s: list[float] = []
    for count in range(options.rounds + 1):
        for key, run in runs.items():
            theirs, ours = clock(lambda: peer(frame), now), clock(run, now)
            if count:
                theirs_s.append(theirs)
                seconds[key].append(ours / theirs)
    ratios: dict[str, dict[str, float]] = {}
    for net, how in runs:
        ratios.setdefault(net, {})[how] = round(float(np.median(seconds[net, how])), 2)
    return {"sgbm_ms": 1e3 * float(np.median(theirs_s)), "ratios": ratios}


def counts(net: str, how: str, kind: Any) -> bool:
    """Tell whether a runtime's time says something about this process's kind of CPU."""
    if how == "bf16":
        return available(kind)
    if how == "int8":
        return int8.runs(net, NETS[net])
    return how == "fp32" or cpu.mode() in ("avx512_bf16", "avx512") or cpu.mode() == _own()


def _own() -> str:
    return cpu.supported()[0]


def clock(run: Callable[[], Any], now: Callable[[], float]) -> float:
    """Return the seconds of a call."""
    start = now()
    run()
    return now() - start


def in_memory(frame: Frame) -> Frame:
    """Return the frame with its images read, so that only the method is timed."""
    image, other = frame.image(), frame.other()
    return replace(frame, readers={**frame.readers, "image": lambda: image, "other": lambda: other})


def method(net: str, how: Any, frame: Frame) -> Callable[[], Any]:
    """Return what makes the frame's depth by a network; the samples to complete are in memory."""
    if net == "bts":
        mono = Mono(size="m", runtime=how)
        return lambda: mono(frame)
    if net == "mffnet":
        completion = Completion(model="mffnet", size="s", runtime=how, source="lidar")
        sparse = completion.resolve(frame).lidar(frame).depth_m
        return lambda: completion.fill(sparse, frame.image(), frame.camera)
    model: Any = net
    stereo = Stereo(model=model, size="s", runtime=how, offset_px=NONE.offset_px)
    return lambda: stereo(frame)


if __name__ == "__main__":
    main()
