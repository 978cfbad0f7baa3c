"""Depth maps of the data set: truth and sparse, are they metres, and of this frame?

They are compared with what stereo sees, else with the LiDAR, else with each other. Where nothing else is there, the
ground that they show must lie as far below the camera as a car's does.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from priors.check.axes import motion_ratio
from priors.check.calibration import is_usual_baseline
from priors.check.fills import find_fill, judge_fill
from priors.check.finding import Finding
from priors.check.ground import CAR_M, USUAL_M, ground_below
from priors.check.sample import Sample
from priors.check.scale import MAP_FACTORS, name_factor, three_digits
from priors.geometry import rays
from priors.types import Input

Floats = npt.NDArray[np.float64]

KINDS: tuple[Input, ...] = ("truth", "sparse")
FEWEST = 100
"""Pixels that two maps must share."""
OFF, BAD = 0.1, 0.2
"""Deviation, median, that is doubtful, and that means another frame or another camera."""
OTHER_SCALE = 1.4
"""A median ratio that is so much larger or smaller than 1 is another scale."""
ALONG_RAYS = (0.6, 1.6)
"""How the ratio of two maps rises towards the image's edges, as a share of what rays do."""
SPREAD = 0.3
"""Deviation from the median ratio's logarithm, median, beyond which it is no scale."""


@dataclass(frozen=True)
class Comparison:
    """A kind of map and another depth, at the pixels of the sampled frames where both have values."""

    what: str
    reference: str
    depth_m: Floats
    """(n,) of the map."""
    reference_m: Floats
    """(n,)"""
    stretch: Floats
    """(n,) How much longer each pixel's ray is than its part along the camera's z axis."""

    @property
    def ratio(self) -> float:
        """How many times as far the map is, median."""
        return float(np.median(self.depth_m / self.reference_m))

    @property
    def is_scaled(self) -> bool:
        """Whether the map is the reference in another unit."""
        return max(self.ratio, 1 / self.ratio) > OTHER_SCALE and self.spread < SPREAD

    @property
    def differs(self) -> bool:
        """Whether one of the two is wrong."""
        return self.is_scaled or self.deviation > BAD

    @property
    def deviation(self) -> float:
        """Deviation, median, as a share of the reference."""
        return float(np.median(np.abs(self.depth_m / self.reference_m - 1)))

    @property
    def spread(self) -> float:
        """Deviation from the median of the ratio's logarithm, median."""
        return _spread(np.log(self.depth_m / self.reference_m))

    @property
    def is_along_rays(self) -> bool:
        """Whether the map is as much too far at the image's edges as rays are longer there."""
        low, high = np.quantile(self.stretch, (0.25, 0.75))
        logs, middle, edge = np.log(self.depth_m / self.reference_m), self.stretch <= low, self.stretch >= high
        rise = np.median(logs[edge]) - np.median(logs[middle])
        expected = np.median(np.log(self.stretch[edge])) - np.median(np.log(self.stretch[middle]))
        return bool(ALONG_RAYS[0] * expected < rise < ALONG_RAYS[1] * expected)

    @property
    def is_disparity(self) -> bool:
        """Whether the map falls where the reference rises, by the same share."""
        product_spread = _spread(np.log(self.depth_m * self.reference_m))
        return self.spread > 0.1 and product_spread < 0.6 * self.spread


def judge_maps(sampled: Sequence[Sample]) -> Iterator[Finding]:
    """Judge truth and sparse maps of the sampled frames."""
    fills = {what: find_fill(sampled, what) for what in KINDS}
    for what, fill in fills.items():
        for sample in sampled:
            sample.drop(what, None if fill is None else fill.value_m)
    for what in KINDS:
        if not any(what in sample.depths for sample in sampled):
            continue
        yield from judge_fill(what, fills[what])
        others = ("stereo", "LiDAR", *(kind for kind in KINDS if kind != what))
        compared = next((c for name in others if (c := compare(sampled, what, name)) is not None), None)
        if compared is None:
            found, blames_stereo = _judge_ground(sampled, what), False
        elif compared.reference in KINDS and compared.differs and not _is_worse(sampled, compared):
            continue  # the other map is told
        else:
            blames_stereo = _blames_stereo(sampled, compared)
            found = _judge(compared, blames_stereo)
        yield found
        for sample in sampled if found.level in ("warning", "fatal") else ():
            sample.distrust("stereo" if blames_stereo else what)


def compare(sampled: Sequence[Sample], what: str, reference: str) -> Comparison | None:
    """Collect the values of two depths where both have one; None where they share few pixels."""
    depths, references, stretches = [np.zeros(0)], [np.zeros(0)], [np.zeros(0)]
    for sample in sampled:
        depth_m, reference_m = sample.depths.get(what), sample.depths.get(reference)
        if depth_m is not None and reference_m is not None:
            both = (depth_m > 0) & (reference_m > 0)
            depths.append(depth_m[both].astype(np.float64))
            references.append(reference_m[both].astype(np.float64))
            stretches.append(np.linalg.norm(rays(sample.frame.camera), axis=-1)[both])
    if sum(map(len, depths)) < FEWEST:
        return None
    return Comparison(what, reference, *map(np.concatenate, (depths, references, stretches)))


def _judge(compared: Comparison, stereo_is_off: bool) -> Finding:
    """Say what a comparison means."""
    seen = f"the {compared.reference} maps" if compared.reference in KINDS else compared.reference
    text = f"median deviation from {seen} {compared.deviation:.1%} of the depth ({len(compared.depth_m)} pixels)"
    if compared.is_scaled:
        scale = f"its depth is {three_digits(compared.ratio)} times that of {seen}"
        cause = name_factor(compared.ratio, MAP_FACTORS)
        if stereo_is_off:
            cause = "but so is that of others, or the baseline is unusual: are baseline and focal length right?"
        return Finding("fatal", compared.what, f"{scale}: {cause}")
    if compared.deviation > BAD:
        which = "is one of the two" if compared.reference in KINDS else "is it"
        holds = f"{which} of other frames, of another camera, or mirrored?"
        if compared.is_disparity:
            which = "one of the two holds" if compared.reference in KINDS else "it holds"
            holds = f"{which} disparities: a depth map holds metres: see docs/datasets.md"
        return Finding("fatal", compared.what, f"{text}: {holds}")
    if compared.is_along_rays:
        meant = "along the rays, not along the camera's z axis? divide by the rays' length"
        return Finding("warning", compared.what, f"{text}, more at the image's edges: does it hold distances {meant}")
    return Finding("warning" if compared.deviation > OFF else "ok", compared.what, text)


def _blames_stereo(sampled: Sequence[Sample], compared: Comparison) -> bool:
    """Tell whether LiDAR or the poses' motion differ from stereo by a map's factor, or no car has such a baseline."""
    if compared.reference != "stereo":
        return False
    if sampled[0].distrusts("stereo") or not is_usual_baseline(sampled[0].frame):
        return True
    lidar = compare(sampled, "LiDAR", "stereo")
    others = [None if lidar is None else lidar.ratio, motion_ratio(sampled, "stereo")]
    return any(ratio is not None and abs(float(np.log(ratio / compared.ratio))) < SPREAD for ratio in others)


def _is_worse(sampled: Sequence[Sample], compared: Comparison) -> bool:
    """Tell which of two maps is in another unit: that whose ground is farther from where a car's is."""
    off = []
    for kind in (compared.what, compared.reference):
        ground_m = ground_below(sampled, kind)
        off.append(0.0 if ground_m is None else abs(float(np.log(ground_m / USUAL_M))))
    return off[0] > off[1] or (off[0] == off[1] and compared.what == KINDS[0])


def _judge_ground(sampled: Sequence[Sample], what: str) -> Finding:
    """Judge a map that nothing else can be compared with by how far the ground lies below the camera."""
    ground_m = ground_below(sampled, what)
    if ground_m is None:
        return Finding("note", what, "its scale is not checked: it needs the second camera, a LiDAR or the other map")
    text = f"by it the ground lies {ground_m:.2f} m below the camera"
    if CAR_M[0] < ground_m < CAR_M[1]:
        return Finding("ok", what, text)
    motion = motion_ratio(sampled, what)  # the poses' over the map's
    factor = ground_m / USUAL_M if motion is None else 1 / motion
    return Finding("warning", what, f"{text}, where no car's camera is: {name_factor(factor, MAP_FACTORS)}")


def _spread(values: Floats) -> float:
    return float(np.median(np.abs(values - np.median(values))))
