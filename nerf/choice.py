"""Choice: which family `--field auto` trains, by what a scene has and what was asked for.

Gaussians start from the surfaces that a prior shows, and measured better than every hash field where those are dense
and right. Elsewhere the best hash field is taken: docs/nerf.md, "Which field, how long", has the figures.
"""

from dataclasses import dataclass, replace

import numpy as np

from nerf import fields
from nerf.config import FitConfig
from nerf.evidence.check import Checked
from nerf.quality import BEST, GAUSSIANS
from nerf.scene import Scene
from nerf.world import here

AUTO = "auto"
"""Stands for the family that is chosen."""
DENSE = 0.7
"""Share of the pixels below the sky at which a prior must be sure of a depth for Gaussians to start from: stereo has
0.75 and more, completion 0.65 to 0.7, LiDAR alone 0.1 to 0.55."""
SURE = 0.2
"""Confidence from which on a prior is sure enough: what guides and carves in hash fields (`--trust`)."""
WRONG = 0.18
"""Share of the patches that other images show at another depth up to which Gaussians start right: stereo and completion
have 0.1, mono 0.25 to 0.3."""
LOOKED_AT = 8
"""Training frames whose maps are looked at, at most; evenly spread."""


@dataclass(frozen=True)
class Choice:
    """A family, and why it was chosen."""

    family: str
    why: str


def by_settings(config: FitConfig, device: str) -> Choice | None:
    """Choose by what was asked for alone; None where the scene decides.

    Args:
        config: what was asked for, of any family.
        device: cpu or cuda.
    """
    if config.blocks_m is not None:
        return Choice(BEST, "blocks are fields of hash grids")
    if here().size > 1:
        return Choice(BEST, "several processes fit hash fields only")
    if config.align == "learn":
        return Choice(BEST, "--align learn needs a hash field")
    if device != "cpu":
        return Choice(BEST, "Gaussians have no kernels for a GPU")
    unread = fields.unread(replace(config, model=replace(config.model, family=GAUSSIANS)))
    if unread:
        return Choice(BEST, f"Gaussians do not read {', '.join(unread)}")
    return None


def by_scene(checked: Checked) -> Choice:
    """Choose by a scene whose prior was checked."""
    scene, finding = checked.scene, checked.finding
    if finding is not None and not finding.used:
        return Choice(BEST, "the prior is left out")
    if scene.depth_m is None:
        return Choice(BEST, "there is no prior")
    share = covered(scene)
    if finding is not None and finding.wrong > WRONG:
        return Choice(BEST, f"other images show {100 * finding.wrong:.0f} % of the prior's patches at another depth")
    if share < DENSE:
        return Choice(BEST, f"the prior is sure at {100 * share:.0f} % of the pixels below the sky")
    return Choice(GAUSSIANS, f"the prior is sure at {100 * share:.0f} % of the pixels below the sky")


def covered(scene: Scene) -> float:
    """Return the share of the pixels below the sky at which a prior is sure of a depth, over some training frames."""
    assert scene.depth_m is not None
    there, solid = 0, 0
    for position in scene.train[:: -(-len(scene.train) // LOOKED_AT)]:
        ground = np.ones(scene.camera.size, bool) if scene.sky is None else np.asarray(scene.sky[position]) == 0
        known = np.asarray(scene.depth_m[position]) > 0
        if scene.weight is not None:
            known &= np.asarray(scene.weight[position]) >= SURE * 255
        there += int((known & ground).sum())
        solid += int(ground.sum())
    return there / max(solid, 1)
