"""Blocks: a long drive cut by its path; each block is a field of its own, and views blend those around them.

    |---- block 0 ----|---- block 1 ----|---- block 2 ----|      the path, equal lengths
    |<---- trains on ---->|                                      and OVERLAP of a length beyond each border
              |<---- trains on ---------->|
                    ~~~                                          both are rendered and blended: half of that

As in Block-NeRF (Tancik et al., CVPR 2022), but along the path: a weight falls linearly from one block to the next, and
the weights at a place sum to 1. A field's resolution and memory are spent on its own block.

<run>/blocks.json            the path and where it is cut
     /blocks/00/...          a fit each: checkpoint.safetensors, metrics.jsonl
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from eval.files import write_bytes
from nerf.scene import Scene
from priors.errors import DataError, expect
from priors.types import Matrix

NAME, FOLDER = "blocks.json", "blocks"
OVERLAP = 0.25
"""Of a block's length: what it is trained on beyond its own stretch. Views blend in the inner half of that."""
LEAST_VIEWS = 2
"""Training views of a block."""
Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Blocks:
    """Where a path is cut."""

    path_m: Floats
    """(frames, 3) positions of the scene's frames, in the scene's frame, metres."""
    borders_m: list[float]
    """Along the path: where blocks begin, and the end of the last one."""

    @classmethod
    def cut(cls, scene: Scene, length_m: float) -> "Blocks":
        """Cut the path of a scene's frames into equal blocks of about this length.

        Raises:
            UsageError: a block has too few training views.
        """
        made = cls(scene.T_world_cam[:, :3, 3], [])
        whole_m = float(made.along_m[-1])
        count = max(1, round(whole_m / length_m))
        made = replace(made, borders_m=np.linspace(0, whole_m, count + 1).tolist())
        views = [len(made.scene(scene, number).train) for number in range(count)]
        told = f"longer blocks: one has {min(views)} training views"
        expect(min(views) >= min(LEAST_VIEWS, len(scene.train)), "--blocks", f"{length_m:g}", told)
        return made

    def __len__(self) -> int:
        return len(self.borders_m) - 1

    @property
    def along_m(self) -> Floats:
        """(frames,) how far along the path each frame is, metres."""
        steps = np.linalg.norm(np.diff(self.path_m, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)])

    @property
    def reach_m(self) -> float:
        """How far beyond its borders a block is trained."""
        return OVERLAP * (self.borders_m[1] - self.borders_m[0])

    def frames(self, number: int) -> range:
        """Return the frames that a block is trained around."""
        low, high = self.borders_m[number] - self.reach_m, self.borders_m[number + 1] + self.reach_m
        inside = np.flatnonzero((self.along_m >= low) & (self.along_m <= high))
        return range(int(inside[0]), int(inside[-1]) + 1) if len(inside) else range(0)

    def scene(self, scene: Scene, number: int) -> Scene:
        """Return the scene of one block: the same arrays, of which it trains on its own frames."""
        own = self.frames(number)
        train = [position for position in scene.train if position in own]
        test = [position for position in scene.test if position in own]
        return replace(
            scene, name=f"{scene.name}, block {number}", train=train, test=test, around=(own.start, own.stop)
        )

    def weights(self, T_world_cam: Matrix) -> Floats:
        """Return how much each block counts (blocks,) in a view from a pose in the scene's frame; they sum to 1."""
        at_m, half_m = self._nearest_m(T_world_cam[:3, 3]), self.reach_m / 2
        low, high = np.array(self.borders_m[:-1]), np.array(self.borders_m[1:])
        if half_m == 0:
            return np.eye(len(self))[0]
        rises = np.clip((at_m - low) / (2 * half_m) + 0.5, 0, 1)
        falls = np.clip((high - at_m) / (2 * half_m) + 0.5, 0, 1)
        rises[0] = falls[-1] = 1.0
        weights = np.minimum(rises, falls)
        return np.asarray(weights / weights.sum())

    def _nearest_m(self, position_m: Floats) -> float:
        """Return how far along the path the point of it is that is nearest to a position."""
        if len(self.path_m) == 1:
            return 0.0
        begin, steps = self.path_m[:-1], np.diff(self.path_m, axis=0)
        squared = np.maximum((steps**2).sum(1), 1e-12)
        share = np.clip(((position_m - begin) * steps).sum(1) / squared, 0, 1)
        away = np.linalg.norm(begin + share[:, None] * steps - position_m, axis=1)
        best = int(away.argmin())
        along = self.along_m
        return float(along[best] + share[best] * (along[best + 1] - along[best]))

    def save(self, run: Path) -> None:
        """Write it into a run's folder; DataError where the run was cut otherwise."""
        if (run / NAME).exists() and not same(load(run), self):
            raise DataError(f"{run / NAME}: this run was cut otherwise: choose another --run, or delete it")
        record = {"path_m": self.path_m.tolist(), "borders_m": self.borders_m}
        write_bytes(run / NAME, (json.dumps(record) + "\n").encode())


def same(one: Blocks, other: Blocks) -> bool:
    """Tell whether two are cut alike."""
    return one.borders_m == other.borders_m and np.array_equal(one.path_m, other.path_m)


def load(run: Path) -> Blocks:
    """Read where a run's path was cut; DataError where it is damaged."""
    path = run / NAME
    try:
        record: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        made = Blocks(np.array(record["path_m"], np.float64).reshape(-1, 3), list(map(float, record["borders_m"])))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DataError(f"{path}: damaged ({error}): delete the run and train again") from error
    return made


def parts_of(run: Path) -> list[Path]:
    """Return the folders of a run's checkpoints: its own, or those of its blocks."""
    if not (run / NAME).exists():
        return [run]
    return [part(run, number) for number in range(len(load(run)))]


def part(run: Path, number: int) -> Path:
    """Return the folder of a block's fit."""
    return run / FOLDER / f"{number:02d}"
