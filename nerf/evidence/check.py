"""Check: a scene's prior against its posed training images, before a fit; held-out frames take no part.

1. Blank images are left out of training (nerf/evidence/blank.py).
2. Scale: each frame's patches say by which factor its depths suit the images (nerf/evidence/scale.py). Where the images
   cannot tell, the LiDAR does (nerf/evidence/lidar.py).
3. Votes: values that the other frames' maps contradict are left out (nerf/evidence/votes.py), but for those that go on
   into a trusted surface (nerf/evidence/whole.py).
4. What is left is looked for in the images once more. Where too much of it is found at another depth, the prior would
   hurt, and the fit is better off without it.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from nerf.evidence import kept as kept_files
from nerf.evidence.blank import blank_frames
from nerf.evidence.corrected import Corrected
from nerf.evidence.finding import Finding
from nerf.evidence.kept import Kept, Rounds, Trust
from nerf.evidence.lidar import Sweeps, ratios
from nerf.evidence.patches import Shot
from nerf.evidence.scale import FACTORS, along, look, scale_of, wrong_share
from nerf.evidence.votes import ROUNDS, Council, inverse_of
from nerf.evidence.whole import trusted_whole
from nerf.scene import Scene
from nerf.warp.frames import unlike_m
from priors.sky import sky_mask

Floats = npt.NDArray[np.float32]

NEAREST = 4
"""Frames that each frame is compared with."""
LOOKED_AT = 24
"""Frames whose patches are looked for, at most; evenly spread. The others' scale lies between theirs."""
SURE = 0.2
"""Confidence from which on a value is looked for: below it, it guides nothing anyway."""
SOLID = 0.5
"""Confidence from which on a value is rather a surface than sky."""
MOST_WRONG = 0.3
"""Share of found patches at another depth above which a prior hurts."""
USUAL = 0.1
"""Share of the values that frames contradict in a right prior, too: at edges, far away and on what moves. Up to this
all are kept: a loss that is trimmed stands them, and those of them that are right are missed."""
MOST_DROPPED = 0.5
"""Share of the values that other frames contradict above which nothing is known of those that are left."""


@dataclass(frozen=True)
class Checked:
    """A scene after the check."""

    scene: Scene
    """With the corrected prior, or without it."""
    finding: Finding | None
    """None: there was nothing to tell, or nothing was checked."""


def check(scene: Scene, needed: bool = False, sweeps: Sweeps | None = None) -> Checked:
    """Check a scene. What was found before of the same maps and frames is read again.

    Args:
        scene: its prior's maps are files, and the result is kept beside them; or arrays, and it is not.
        needed: the prior is used whatever is found: there is nothing to go on by without it.
        sweeps: reads the frames' own LiDAR; None: there is none.
    """
    scene, blank = _without_blank(scene)
    if scene.depth_m is None:
        return Checked(scene, Finding(blank=blank) if blank else None)
    place = kept_files.place_of(scene, sweeps is not None)
    kept = kept_files.read(place)
    if kept is None:
        with Rounds.at(place, (len(scene.ids), *scene.camera.size)) as rounds:
            kept = _Check(scene, sweeps, rounds).run()
        kept_files.keep(place, kept)
    finding = replace(kept.finding, blank=blank, used=kept.finding.used or needed)
    if not finding.used:
        return Checked(replace(scene, depth_m=None, weight=None, sky=None), finding)
    if kept.trust is None and finding.spread == (1.0, 1.0):
        return Checked(scene, finding)
    assert not isinstance(scene.depth_m, Corrected)
    corrected = Corrected(scene.depth_m, kept.trust, np.array(kept.factors, np.float32))
    return Checked(replace(scene, depth_m=corrected), finding)


def _without_blank(scene: Scene) -> tuple[Scene, tuple[str, ...]]:
    """Return a scene that trains on images that show something, and the ids of the others."""
    blank = set(blank_frames(scene)) & set(scene.train)
    if not blank or len(blank) == len(scene.train):
        return scene, ()
    train = [position for position in scene.train if position not in blank]
    return replace(scene, train=train), tuple(scene.ids[position] for position in sorted(blank))


@dataclass(frozen=True)
class _Check:
    """One check of one scene."""

    scene: Scene
    sweeps: Sweeps | None
    rounds: Rounds

    def run(self) -> Kept:
        """Look, align, vote, and look again."""
        frames = [position for position in self.scene.train if (self._depth_m(position) > 0).any()]
        near = {position: self._nearest(position, frames) for position in frames}
        some = frames[:: -(-len(frames) // LOOKED_AT)] if frames else []
        alike = {position: self._look(position, near[position], self._depth_m(position)) for position in some}
        together = _joined(alike.values())
        scale = scale_of(together)
        own = {position: scale_of(each, scale or 1.0) for position, each in alike.items()}
        lidar, by_lidar = self._lidar(some)
        found = Finding(len(together) if scale is not None else 0, lidar=lidar, sky=self._sky(some))
        if scale is None and lidar is None:
            return self._blind(found, wrong_share(together), len(together))
        told = {position: factor for position, factor in (own if scale is not None else by_lidar).items() if factor}
        factors = np.ones(len(self.scene.ids), np.float32)
        factors[frames] = along(frames, told, scale or lidar or 1.0)
        found = replace(found, scale=float(np.median(factors[frames])))
        found = replace(found, spread=(float(factors[frames].min()), float(factors[frames].max())))
        trust: Trust | None = self._votes(frames, near, factors)
        aligned = self._corrected(trust, factors)
        dropped = self._dropped(aligned, frames)
        if dropped <= USUAL:
            trust, dropped, aligned = None, 0.0, self._corrected(None, factors)
        after = wrong_share(_joined(self._look(position, near[position], aligned[position]) for position in some))
        judged = _judged(replace(found, dropped=dropped), after, wrong_share(together))
        return Kept(judged, trust, factors.tolist())

    def _blind(self, found: Finding, wrong: float | None, patches: int) -> Kept:
        """Judge a prior that suits the images at no scale: it is of something else, or they cannot tell."""
        if wrong is None or wrong <= MOST_WRONG:
            return Kept(found)
        return Kept(replace(found, patches=patches, wrong=wrong, used=False))

    def _lidar(self, some: list[int]) -> tuple[float | None, dict[int, float | None]]:
        """Return the factor that the LiDAR tells of all frames and of each; None: it tells none."""
        if self.sweeps is None:
            return None, {}
        own: dict[int, float | None] = {}
        for position in some:
            found = ratios(self._sure_m(position, self._depth_m(position)), self.sweeps(position))
            own[position] = float(np.median(found)) if len(found) else None
        known = [factor for factor in own.values() if factor is not None]
        return (float(np.median(known)) if known else None), own

    def _sky(self, some: list[int]) -> float:
        """Return the share of the images' sky in which the prior is sure of a surface."""
        sky = solid = 0
        for position in some:
            mask = sky_mask(self.scene.images[position])
            sure = (self._depth_m(position) > 0) & (self._weight(position) >= SOLID)
            sky, solid = sky + int(mask.sum()), solid + int((mask & sure).sum())
        return solid / sky if sky else 0.0

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

    def _sure_m(self, position: int, depth_m: Floats) -> Floats:
        """Return a map without the values that are not sure."""
        return np.where(self._weight(position) >= SURE, depth_m, np.float32(0))

    def _nearest(self, position: int, frames: list[int]) -> list[int]:
        """Return the frames nearest to one, by place and by where the camera looks."""
        poses, own = self.scene.T_world_cam[frames], self.scene.T_world_cam[position]
        order = [frames[index] for index in np.argsort(unlike_m(poses, own), kind="stable")]
        return [other for other in order if other != position][:NEAREST]

    def _look(self, position: int, near: list[int], depth_m: Floats) -> Floats:
        """Look for a frame's patches in the two frames nearest to it, where the prior is sure."""
        shots = [self._shot(number) for number in (position, *near[:2])]
        return look(shots, self._sure_m(position, depth_m), seed=position)

    def _shot(self, position: int) -> Shot:
        """Read a frame's image in grey."""
        image = self.scene.images[position]
        grey = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY).astype(np.float32)
        return Shot(grey, self.scene.camera, self.scene.T_world_cam[position])

    def _votes(self, frames: list[int], near: dict[int, list[int]], factors: Floats) -> Trust:
        """Return the trust of all frames' values, x 255; held-out frames are trusted, and never asked."""
        poses = {position: self.scene.T_world_cam[position] for position in frames}

        def aligned(position: int) -> Floats:
            return np.asarray(self._depth_m(position) * factors[position])

        council = Council(self.scene.camera, poses, near, aligned, self._weight)
        everything, trust = np.full(self.scene.camera.size, 255, np.uint8), None

        def counted(before: Trust | None, last: bool) -> Iterator[npt.NDArray[np.uint8]]:
            for position in range(len(self.scene.ids)):
                if position not in poses:
                    yield everything
                    continue
                own = council.count(position, (lambda other: None) if before is None else before.__getitem__)
                inverse = inverse_of(self._depth_m(position))
                yield trusted_whole(inverse, own, self._weight(position)) if last else own

        for number in range(ROUNDS):
            last = number == ROUNDS - 1
            trust = self.rounds.write(counted(trust, last), last=last)
        assert trust is not None
        return trust

    def _corrected(self, trust: Trust | None, factors: Floats) -> Corrected:
        """Return the prior as a fit would see it."""
        assert self.scene.depth_m is not None and not isinstance(self.scene.depth_m, Corrected)
        return Corrected(self.scene.depth_m, trust, factors)

    def _dropped(self, aligned: Corrected, frames: list[int]) -> float:
        """Return the share of the values, by their weights, that is left out."""
        before = after = 0.0
        for position in frames:
            weight = self._weight(position)
            before += float(weight[self._depth_m(position) > 0].sum())
            after += float(weight[aligned[position] > 0].sum())
        return 1 - after / before if before else 0.0


def _judged(found: Finding, after: float | None, before: float | None) -> Finding:
    """Judge what is left by the share of it that other images show elsewhere, after the check and before it."""
    wrong = float(before is not None) if after is None else after  # nothing is found any more, or never was
    return replace(found, wrong=wrong, used=wrong <= MOST_WRONG and found.dropped <= MOST_DROPPED)


def _joined(alike: Iterable[Floats]) -> Floats:
    """Join the likeness (n, FACTORS) of several frames' patches."""
    return np.concatenate([*alike, np.zeros((0, len(FACTORS)), np.float32)])
