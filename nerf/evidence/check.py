"""Check: a scene's prior against its posed training images, before a fit; held-out frames take no part.

1. Scale: each frame's patches say by which factor its depths suit the images (nerf/evidence/scale.py). A frame keeps to
   the drive's median, unless its own patches say otherwise.
2. Votes: values that the other frames' maps contradict are left out (nerf/evidence/votes.py).
3. What is left is looked for in the images once more. Where too much of it is found at another depth, the prior would
   hurt, and the fit is better off without it.
"""

import hashlib
import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from eval.files import write_bytes
from nerf.evidence.corrected import Corrected
from nerf.evidence.finding import Finding
from nerf.evidence.patches import Shot
from nerf.evidence.scale import FACTORS, look, scale_of, wrong_share
from nerf.evidence.votes import Council
from nerf.scene import Scene
from nerf.stack import Stack, StackWriter

Floats = npt.NDArray[np.float32]

VERSION = 1
"""Raised when the same scene is judged otherwise: what was kept of it is not read then."""
NEAREST = 4
"""Frames that each frame is compared with."""
LOOKED_AT = 24
"""Frames whose patches are looked for, at most; evenly spread. The others take the drive's scale."""
SURE = 0.2
"""Confidence from which on a value is looked for and votes fully counted: below it, it guides nothing anyway."""
MOST_WRONG = 0.25
"""Share of found patches at another depth above which a prior hurts."""
MOST_DROPPED = 0.5
"""Share of the values that other frames contradict above which nothing is known of those that are left."""
WITHIN = 1.5
"""A frame's own scale is believed where it is within this factor of the drive's."""
TURN_M = 10.0
"""A camera turned by 1 radian is as unlike as one that is so many metres away."""


@dataclass(frozen=True)
class Checked:
    """A scene after the check."""

    scene: Scene
    """With the corrected prior, or without it."""
    finding: Finding | None
    """None: nothing was checked, there is no prior."""


def check(scene: Scene, needed: bool = False) -> Checked:
    """Check a scene's prior. What was found before of the same maps and frames is read again.

    Args:
        scene: its prior's maps are files, and the result is kept beside them; or arrays, and it is not.
        needed: the prior is used whatever is found: there is nothing to go on by without it.
    """
    if scene.depth_m is None:
        return Checked(scene, None)
    kept = _read(scene)
    if kept is None:
        kept = _Check(scene).run()
        kept = _keep(scene, *kept)
    finding, trust, factors = kept
    if not finding.used and not needed:
        return Checked(replace(scene, depth_m=None, weight=None, sky=None), finding)
    finding = replace(finding, used=True)
    if trust is None:
        return Checked(scene, finding)
    assert not isinstance(scene.depth_m, Corrected)
    return Checked(replace(scene, depth_m=Corrected(scene.depth_m, trust, factors)), finding)


Kept = tuple[Finding, Stack | npt.NDArray[np.uint8] | None, Floats]
"""A finding, the values' trust (None: it could not be checked), and the frames' factors."""


@dataclass(frozen=True)
class _Check:
    """One check of one scene."""

    scene: Scene

    def run(self) -> Kept:
        """Look, align, vote, and look again."""
        frames = [position for position in self.scene.train if (self._depth_m(position) > 0).any()]
        near = {position: self._nearest(position, frames) for position in frames}
        factors = np.ones(len(self.scene.ids), np.float32)
        some = frames[:: -(-len(frames) // LOOKED_AT)] if len(frames) > 1 else []
        alike = {position: self._look(position, near[position], self._depth_m(position)) for position in some}
        together = np.concatenate([*alike.values(), np.zeros((0, len(FACTORS)), np.float32)])
        before, scale = wrong_share(together), scale_of(together)
        if scale is None:
            if before is None or before <= MOST_WRONG:
                return Finding(), None, factors
            return Finding(patches=len(together), wrong=before, used=False), None, factors
        for position in frames:
            factors[position] = self._own_scale(alike.get(position), scale)
        trust = self._votes(frames, near, factors)
        aligned = Corrected(self.scene.depth_m, trust, factors)  # type: ignore[arg-type]
        after = wrong_share(
            np.concatenate([self._look(position, near[position], aligned[position]) for position in some])
        )
        wrong = float(before is not None) if after is None else after  # nothing is found any more, or never was
        return self._finding(aligned, factors[frames], (frames, len(together)), wrong), trust, factors

    def _finding(self, aligned: Corrected, factors: Floats, seen: tuple[list[int], int], wrong: float) -> Finding:
        """Put together what was found of some frames, with their factors (f,), in so many patches."""
        frames, patches = seen
        spread = float(factors.min()), float(factors.max())
        dropped = self._dropped(aligned, frames)
        used = wrong <= MOST_WRONG and dropped <= MOST_DROPPED
        return Finding(patches, float(np.median(factors)), spread, dropped, wrong, used)

    def _own_scale(self, alike: Floats | None, drive: float) -> float:
        """Return a frame's scale: the drive's, unless its own patches (n, FACTORS) say another near it."""
        own = None if alike is None else scale_of(alike)
        return own if own is not None and drive / WITHIN <= own <= drive * WITHIN else drive

    def _depth_m(self, position: int) -> Floats:
        """Read a map; what is no depth is no value."""
        assert self.scene.depth_m is not None
        depth_m = self.scene.depth_m[position]
        return np.where(np.isfinite(depth_m) & (depth_m > 0), depth_m, np.float32(0)).astype(np.float32)

    def _weight(self, position: int) -> Floats:
        """Read how much a frame's values count."""
        if self.scene.weight is None:
            return np.ones(self.scene.camera.size, np.float32)
        return (self.scene.weight[position] / np.float32(255)).astype(np.float32)

    def _nearest(self, position: int, frames: list[int]) -> list[int]:
        """Return the frames nearest to one, by place and by where the camera looks."""
        poses, own = self.scene.T_world_cam[frames], self.scene.T_world_cam[position]
        cosine = np.clip(poses[:, :3, 2] @ own[:3, 2], -1, 1)
        away_m = np.linalg.norm(poses[:, :3, 3] - own[:3, 3], axis=1) + TURN_M * np.arccos(cosine)
        order = [frames[index] for index in np.argsort(away_m, kind="stable")]
        return [other for other in order if other != position][:NEAREST]

    def _look(self, position: int, near: list[int], depth_m: Floats) -> Floats:
        """Look for a frame's patches in the two frames nearest to it, where the prior is sure."""
        sure = np.where(self._weight(position) >= SURE, depth_m, np.float32(0))
        return look([self._shot(number) for number in (position, *near[:2])], sure, seed=position)

    def _shot(self, position: int) -> Shot:
        """Read a frame's image in grey."""
        image = self.scene.images[position]
        grey = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY).astype(np.float32)
        return Shot(grey, self.scene.camera, self.scene.T_world_cam[position])

    def _votes(self, frames: list[int], near: dict[int, list[int]], factors: Floats) -> npt.NDArray[np.uint8]:
        """Return the trust of all frames' values, x 255; held-out frames are trusted, and never asked."""
        poses = {position: self.scene.T_world_cam[position] for position in frames}

        def aligned(position: int) -> Floats:
            return np.asarray(self._depth_m(position) * factors[position])

        trust = np.full((len(self.scene.ids), *self.scene.camera.size), 255, np.uint8)
        for position, found in Council(self.scene.camera, poses, near, aligned, self._weight).trust().items():
            trust[position] = found
        return trust

    def _dropped(self, aligned: Corrected, frames: list[int]) -> float:
        """Return the share of the values, by their weights, that is left out."""
        before = after = 0.0
        for position in frames:
            weight = self._weight(position)
            before += float(weight[self._depth_m(position) > 0].sum())
            after += float(weight[aligned[position] > 0].sum())
        return 1 - after / before if before else 0.0


def _place(scene: Scene) -> Path | None:
    """Return where the check of a scene's files is kept, without an ending; None: it is not."""
    if not isinstance(scene.depth_m, Stack):
        return None
    digest = hashlib.sha256(repr((VERSION, scene.train)).encode() + scene.T_world_cam.tobytes()).hexdigest()[:10]
    return scene.depth_m.path.parent / f"checked-{digest}"


def _read(scene: Scene) -> Kept | None:
    """Read what was found before; None where nothing was kept."""
    place = _place(scene)
    if place is None or not place.with_suffix(".json").exists():
        return None
    record = json.loads(place.with_suffix(".json").read_text(encoding="utf-8"))
    factors = np.array(record.pop("factors"), np.float32)
    finding = Finding(**(record | {"spread": tuple(record["spread"])}))
    trust = place.with_suffix(".npy")
    return finding, Stack(trust) if trust.exists() else None, factors


def _keep(scene: Scene, finding: Finding, trust: Stack | npt.NDArray[np.uint8] | None, factors: Floats) -> Kept:
    """Keep what was found beside the prior's maps, where those are files."""
    place = _place(scene)
    if place is None:
        return finding, trust, factors
    if trust is not None:
        with StackWriter(place.with_suffix(".npy"), trust.shape, np.uint8) as files:
            for position in range(len(scene.ids)):
                files.add(trust[position])
        trust = Stack(place.with_suffix(".npy"))
    write_bytes(place.with_suffix(".json"), json.dumps(asdict(finding) | {"factors": factors.tolist()}).encode())
    return finding, trust, factors
