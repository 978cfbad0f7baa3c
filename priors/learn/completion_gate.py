"""From which density of samples on a completion network is not better than the fill that it corrects.

    priors train calibrate priors/weights/mffnet-s.safetensors --street samples/ --real DATA

It runs the network on what training held back of real scenes, at each density, and writes two densities into the
header of the weights: up to `full` the network counts in full, from `none` on not at all (methods/_completion_gate.py).
`full` is the densest single sweep's. `none` is that of the sparsest kind of accumulated map where the network is worse
than its fill, in relative error or in RMSE.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from priors.learn.completion import CompletionConfig, CompletionTask
from priors.learn.lidar_dropout import CompletionExample
from priors.methods._completion_classical import complete, list_samples, near_samples
from priors.methods._completion_gate import ENTRY, DensityGate, density_of
from priors.methods.completion import Completion
from priors.nets import weights

REACH_PX = Completion.reach_px
STREET = "street"


@dataclass(frozen=True, slots=True)
class Standing:
    """How a network does at one density of one source."""

    name: str
    accumulated: bool
    """Of several sweeps."""
    density: float
    densest: float
    """Of the examples; the density is their mean."""
    abs_rel: float
    """The network's, as a multiple of the fill's; so is the next."""
    rmse: float

    @property
    def worse(self) -> bool:
        """Tell whether the network is worse than its fill in one of them."""
        return max(self.abs_rel, self.rmse) > 1


def choose(standings: Sequence[Standing]) -> DensityGate | None:
    """Choose the gate; None where no accumulated map makes the network worse."""
    full = max((one.densest for one in standings if not one.accumulated), default=0.0)
    worse = [one.density for one in standings if one.accumulated and one.worse and one.density > full]
    return DensityGate(round(full, 4), round(min(worse), 4)) if worse else None


def stand(name: str, examples: Sequence[CompletionExample], net: Completion) -> Standing:
    """Measure a network beside the classical fill on examples of one density."""
    rows, densities = [], []
    for one in examples:
        given = one.sparse_m, one.scene.image, one.scene.camera, one.T_cam_lidar
        known = one.weight > 0
        errors = [fill[known] - one.truth_m[known] for fill in (net.fill(*given).depth_m, complete(*given).depth_m)]
        rows.append([(np.abs(error / one.truth_m[known]).mean(), np.sqrt(np.mean(error**2))) for error in errors])
        samples = list_samples(one.sparse_m)
        densities.append(density_of(one.sparse_m, near_samples(samples, one.sparse_m.shape, REACH_PX)))
    ours, theirs = np.mean(rows, axis=0)
    abs_rel, rmse = (float(ratio) for ratio in ours / theirs)
    return Standing(name, examples[0].T_cam_lidar is None, float(np.mean(densities)), max(densities), abs_rel, rmse)


def calibrate_file(file: Path, street: Path, real: Path | None) -> list[str]:
    """Measure a file of weights and write its gate into its header; returns lines that tell what was found."""
    about = weights.read_about(file)
    weights.rewrite_about(file, **{ENTRY: None})  # it counts in full while it is measured
    task = CompletionTask(CompletionConfig(street, real, size=about["size"]))
    net = Completion(model="mffnet", size=about["size"], weights=file)
    standings = [stand(name, examples, net) for name, examples in task.held_back().items()]
    gate = choose([one for one in standings if not one.name.startswith(STREET)])
    weights.rewrite_about(file, **{ENTRY: None if gate is None else [gate.full, gate.none]})
    lines = [
        f"{one.name}: density {one.density:.3f}; AbsRel {one.abs_rel:.2f}, RMSE {one.rmse:.2f} of the fill's"
        for one in standings
    ]
    told = "counts at every density" if gate is None else f"counts up to density {gate.full}, not from {gate.none} on"
    return [*lines, f"the network {told}"]
