"""Start: a scene's prior as Gaussians, before the first step.

Frames are gone through from the last to the first: a car that drives forward sees each surface finest just before it
leaves the view. Of each frame's cells those become discs that nothing taken so far covers, and that the neighbouring
frames do not look through: first where the prior is sure, then wherever it has a value or one is near. What is still
empty gets a coarse layer, at a depth that is filled in from around. Without a prior, a hash field shows the depth
(nerf/gaussians/field_first.py).
"""

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from nerf.gaussians.cover import Cover, looked_through
from nerf.gaussians.look import Look, look_at
from nerf.gaussians.seeds import Lattice, Seeds
from nerf.scene import Scene
from nerf.warp.frames import unlike_m
from priors.machine import threads

Flags = npt.NDArray[np.bool_]

SURE = 0.1
"""Trust from which on a value is taken in the first pass."""
NEIGHBOURS = 4
"""Frames that are asked whether they look through a place."""
KEPT_BYTES = 256 << 20
"""Prepared frames of so many bytes are kept: the passes need each three times."""
CELLS = 30_000
"""Cells of a frame, about, where nobody says how fine the start is."""
LEAST_STEP = 2
"""The finest start that nobody asked for: twice as many Gaussians cost more time than they give."""
ROOM = 0.6
"""Where nobody says how fine the start is, it takes this share of the Gaussians there may be at most: the rest is for
what the images ask for."""
COARSE = 3
"""A cell of the coarse layer is so many times as wide."""


def usual_step(size: tuple[int, int]) -> int:
    """Return how fine a start is where nobody says it."""
    return max(LEAST_STEP, int(np.ceil(np.sqrt(size[0] * size[1] / CELLS))))


def start_of(scene: Scene, step: int, most: int) -> Seeds:
    """Make the seeds of a scene.

    Args:
        scene: its training frames, with a prior.
        step: every so many-th pixel along rows and columns is a candidate; 0: as the images' size and `most` allow.
        most: how many seeds there may be; where `step` gives more, it is raised.
    """
    most = most if step else int(ROOM * most)
    start = _Start(scene, step or usual_step(scene.camera.size))
    while len(seeds := start.seeds()) > most:
        coarser = start.step + max(1, int(start.step * (np.sqrt(len(seeds) / most) - 1)))
        start = replace(start, step=coarser, cover=Cover())
    return seeds


@dataclass(frozen=True)
class _Start:
    """One start of one scene."""

    scene: Scene
    step: int
    cover: Cover = field(default_factory=Cover)
    _looks: OrderedDict[int, Look] = field(default_factory=OrderedDict)

    def seeds(self) -> Seeds:
        """Go through the frames, pass by pass."""
        last_first = self.scene.train[::-1]
        self._prepare(last_first)
        sure = [self._surface(position, lambda at: at.trust >= SURE) for position in last_first]
        guessed = [self._surface(position, lambda at: at.trust > 0) for position in last_first]
        return Seeds.joined([*sure, *guessed, *[self._coarse(position) for position in last_first]])

    def _surface(self, position: int, chosen: Callable[[Lattice], Flags]) -> Seeds:
        """Take what is not covered of the surfaces that a frame sees."""
        look = self._look(position)
        at = Lattice(look, self.step)
        wanted = at.usable & chosen(at) & ~self.cover.cells(look, self.step)[1]
        rows, columns = np.nonzero(wanted)
        others = [self._look(other) for other in self._near[position]]
        kept = ~looked_through(at.means_m[rows, columns], others)
        return self._taken(at.seeds(rows[kept], columns[kept]))

    def _coarse(self, position: int) -> Seeds:
        """Take what is still empty in a frame, at the depth of what is around."""
        look, step = self._look(position), COARSE * self.step
        at = Lattice(look, step)
        return self._taken(at.seeds(*np.nonzero(~at.sky & ~self.cover.cells(look, step)[0])))

    def _taken(self, seeds: Seeds) -> Seeds:
        self.cover.add(seeds.means_m)
        return seeds

    @cached_property
    def _near(self) -> dict[int, list[int]]:
        """The training frames most like each."""
        train, poses = np.array(self.scene.train), self.scene.T_world_cam
        order = {at: np.argsort(unlike_m(poses[train], poses[at]), kind="stable") for at in self.scene.train}
        return {at: [int(other) for other in train[found] if other != at][:NEIGHBOURS] for at, found in order.items()}

    def _prepare(self, positions: list[int]) -> None:
        """Prepare the frames side by side, where all of them can be kept."""
        made = [self._look(positions[0])] * len(positions)
        if len(made) > KEPT_BYTES // made[0].nbytes or set(positions) <= self._looks.keys():
            return

        def prepare(task: int) -> None:
            made[task] = look_at(self.scene, positions[task])
            made[task].normals  # noqa: B018 - they are kept

        threads.run(len(positions), prepare)
        self._looks.update(zip(positions, made, strict=True))

    def _look(self, position: int) -> Look:
        if position not in self._looks:
            self._looks[position] = look_at(self.scene, position)
            while len(self._looks) > max(NEIGHBOURS + 1, KEPT_BYTES // self._looks[position].nbytes):
                self._looks.popitem(last=False)
        self._looks.move_to_end(position)
        return self._looks[position]
