"""The parts: what each is called, may take and needs. A part is a process: it prints figures as lines of JSON."""

import json
from argparse import Namespace
from dataclasses import dataclass
from importlib import import_module
from typing import Any

FIELD = ("torch", "numpy", "scipy", "cv2", "numba", "safetensors", "threadpoolctl")


@dataclass(frozen=True)
class Part:
    """One part of the run."""

    name: str
    module: str
    seconds: float
    """Its budget in a run of full length."""
    needs: tuple[str, ...]
    """Modules that must be importable; those of a GPU's kernels are asked for on a GPU only."""
    title: str


PARTS = (
    Part("machine", "machine", 40, (), "The machine"),
    Part("checks", "checks", 200, (*FIELD, "pytest", "hypothesis", "triton"), "Triton kernels against the twin"),
    Part("bench", "bench", 70, FIELD, "Samples a second"),
    Part("splat", "splat", 130, FIELD, "Gaussians"),
    Part("fit", "fit", 230, FIELD, "The 397x120 drive"),
    Part("train", "training", 50, FIELD, "Training"),
)
"""In this order; 720 s together."""
NETWORKS = ("cfnet", "mffnet", "bts")
"""What the part `train` can train, see training.py."""


def find(name: str) -> Part:
    """Return the part of this name."""
    return next(part for part in PARTS if part.name == name)


def note(**figures: Any) -> None:
    """Print figures as a line that the runner understands and keeps, whatever happens after it."""
    print("\n" + json.dumps(figures), flush=True)  # pytest leaves its dots in a line without an end


def run_here(options: Namespace) -> None:
    """Run one part in this process."""
    import_module("nerf")  # before torch: it tells torch's threads to sleep while others work, not to spin
    import_module(f"tests.bench.gpu.{find(options.part).module}").run(options)
