"""Depth maps of the data set: truth and sparse, are they metres, and of this frame?

They are compared with what stereo sees, else with the LiDAR, else with each other. Where nothing else is there, the
ground that they show must lie as far below the camera as a car's does.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from priors.check.fills import judge_fills, without_fill
from priors.check.finding import Finding
from priors.check.sample import Sample
from priors.check.scale import MAP_FACTORS, name_factor
from priors.types import Camera, FloatMap, Input

Floats = npt.NDArray[np.float64]

KINDS: tuple[Input, ...] = ("truth", "sparse")
FEWEST = 100
"""Pixels that two maps must share."""
OFF, BAD = 0.1, 0.2
"""Deviation, median, that is doubtful, and that means another frame or another camera."""
OTHER_SCALE = 1.4
"""A median ratio that is so much larger or smaller than 1 is another scale."""
SPREAD = 0.3
"""Deviation from the median ratio's logarithm, median, beyond which it is no scale."""
GROUND_M = (0.4, 5.0)
"""How far the ground lies below a car's camera."""
GROUND_SHARE, GROUND_FARTHEST_M, GROUND_FEWEST = 0.9, 30.0, 200


@dataclass(frozen=True)
class Comparison:
    """Two maps of the sampled frames, at the pixels where both have values."""

    reference: str
    depth_m: Floats
    """(n,) of the map in question."""
    reference_m: Floats
    """(n,)"""

    @property
    def ratio(self) -> float:
        """How many times as far the map is, median."""
        return float(np.median(self.depth_m / self.reference_m))

    @property
    def deviation(self) -> float:
        """Deviation, median, as a share of the reference."""
        return float(np.median(np.abs(self.depth_m / self.reference_m - 1)))

    @property
    def spread(self) -> float:
        """Deviation from the median of the ratio's logarithm, median."""
        return _spread(np.log(self.depth_m / self.reference_m))

    @property
    def product_spread(self) -> float:
        """The same of the product's: small where the map holds disparities."""
        return _spread(np.log(self.depth_m * self.reference_m))


def judge_maps(sampled: Sequence[Sample]) -> Iterator[Finding]:
    """Judge truth and sparse maps of the sampled frames."""
    for what in KINDS:
        maps = [(sample, map_m) for sample in sampled if (map_m := sample.depths.get(what)) is not None]
        if not maps:
            continue
        yield from judge_fills(what, maps)
        comparison = next((c for name in _references(what) if (c := _compare(maps, what, name)) is not None), None)
        if comparison is not None:
            yield _judge(what, comparison, _compare(maps, "LiDAR", "stereo"))
        else:
            yield _judge_ground(what, maps)


def _references(what: Input) -> tuple[str, ...]:
    """What a kind of map is compared with, the first that is there; truth and sparse with each other once."""
    return ("stereo", "LiDAR", "sparse") if what == "truth" else ("stereo", "LiDAR", "truth")


def _compare(maps: Sequence[tuple[Sample, FloatMap]], what: str, reference: str) -> Comparison | None:
    """Collect the values of two maps where both have one; None where they share few pixels."""
    depths, references = [], []
    for sample, _ in maps:
        depth_m, reference_m = sample.depths.get(what), sample.depths.get(reference)
        if depth_m is None or reference_m is None:
            continue
        depth_m, reference_m = without_fill(depth_m), without_fill(reference_m)
        both = (depth_m > 0) & (reference_m > 0)
        depths.append(depth_m[both])
        references.append(reference_m[both])
    if sum(map(len, depths)) < FEWEST:
        return None
    return Comparison(reference, *(np.concatenate(parts).astype(np.float64) for parts in (depths, references)))


def _judge(what: str, compared: Comparison, lidar: Comparison | None) -> Finding:
    """Say what a comparison means; `lidar` is that of the LiDAR with stereo, where both are there."""
    ratio, seen = compared.ratio, "the other map" if compared.reference in KINDS else compared.reference
    if compared.reference in KINDS:
        seen = f"the {compared.reference} maps"
    text = f"median deviation from {seen} {compared.deviation:.1%} of the depth ({len(compared.depth_m)} pixels)"
    if max(ratio, 1 / ratio) > OTHER_SCALE and _holds_disparities(compared):
        return Finding("fatal", what, f"{text}: it holds disparities: a depth map holds metres: see docs/datasets.md")
    if max(ratio, 1 / ratio) > OTHER_SCALE and compared.spread < SPREAD:
        scale = f"its depth is {ratio:.3g} times that of {seen}"
        if lidar is not None and compared.reference == "stereo" and abs(np.log(lidar.ratio / ratio)) < SPREAD:
            return Finding("fatal", what, f"{scale}, as LiDAR's is: are baseline and focal length right?")
        return Finding("fatal", what, f"{scale}: {name_factor(ratio, MAP_FACTORS)}")
    if compared.deviation > BAD:
        return Finding("fatal", what, f"{text}: are they of other frames, or of another camera?")
    return Finding("warning" if compared.deviation > OFF else "ok", what, text)


def _holds_disparities(compared: Comparison) -> bool:
    """Tell whether the map falls where the reference rises, by the same share."""
    return compared.spread > 0.1 and compared.product_spread < 0.5 * compared.spread


def _judge_ground(what: str, maps: Sequence[tuple[Sample, FloatMap]]) -> Finding:
    """Judge a map that nothing else can be compared with by how far the ground lies below the camera."""
    below_m = np.concatenate([_below(sample.frame.camera, without_fill(map_m)) for sample, map_m in maps])
    if len(below_m) < GROUND_FEWEST:
        return Finding("note", what, "its scale is not checked: it needs the second camera, a LiDAR or the other map")
    ground_m = float(np.quantile(below_m, GROUND_SHARE))
    text = f"by it the ground lies {ground_m:.2f} m below the camera"
    if GROUND_M[0] < ground_m < GROUND_M[1]:
        return Finding("ok", what, text)
    wanted = "PNG holds metres x 256, .npy and .pfm metres"
    return Finding("warning", what, f"{text}: no car's camera is there: is it in metres ({wanted})?")


def _below(camera: Camera, depth_m: FloatMap) -> Floats:
    """Return how far the points of the image's lower half lie below the camera (n,), metres."""
    rows = np.arange(camera.size[0])[:, None]
    below_m = depth_m * ((rows - camera.K[1, 2]) / camera.K[1, 1])
    counted = (depth_m > 0) & (below_m > 0) & (rows > camera.size[0] // 2)
    # In other units "near" is another distance: the nearest third stands for it.
    if counted.any():
        counted &= depth_m <= max(GROUND_FARTHEST_M, float(np.quantile(depth_m[counted], 0.33)))
    return below_m[counted].astype(np.float64)


def _spread(values: Floats) -> float:
    return float(np.median(np.abs(values - np.median(values))))
