"""Judge: scores a map of a bench against the truth of its frame."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from eval.calibration import Tolerance, calibration_error
from eval.curves import ScoredPixels
from eval.protocol import Protocol
from eval.result import Comparison, score_frame
from priors.cache import Prior
from priors.errors import DataError
from priors.selection import pick_middles
from priors.types import Depth, Drive, Frame

CALIBRATION = "calibration"


@dataclass(frozen=True)
class Judge:
    """Scores maps of a drive's frames by one protocol."""

    drive: Drive
    frames: tuple[int, ...]
    """Indices of the frames that the bench is made on."""
    protocol: Protocol
    truth: Callable[[Frame], Depth] | None
    """Reads a frame's truth; None: there is none, and times alone are measured."""

    def metrics(self, frame: Frame, depth: Depth, sure_within: Tolerance | None) -> dict[str, float]:
        """Return a map's figures: those of eval.result, and a probability's calibration error.

        Args:
            frame: whose map it is.
            depth: the map.
            sure_within: what its confidence is the probability of.

        Raises:
            DataError: the truth cannot be read, or has another size.
        """
        density = {"density_image": depth.density}
        if self.truth is None:
            return density
        pixels: list[ScoredPixels] = []
        compared = Comparison(frame.id, depth.depth_m, depth.confidence, self.truth(frame).depth_m)
        fx_baseline = None if frame.baseline_m is None else frame.camera.fx * frame.baseline_m
        wanted = depth.confidence is not None and sure_within is not None
        row = score_frame(compared, self.protocol, fx_baseline, pixels.append if wanted else None)
        figures = row.metrics() | density
        if wanted and sure_within is not None:
            (found,) = pixels
            right = sure_within.within(found.prediction_m, found.truth_m, fx_baseline)
            figures[CALIBRATION] = calibration_error(found.confidence, right)
        return figures


def judge(
    drive: Drive, indices: Sequence[int], count: int, protocol: Protocol, against: Prior | None, scored: bool = True
) -> Judge:
    """Choose frames, spread evenly over those with a truth, and find how to read it.

    Args:
        drive: the drive.
        indices: the frames to choose from.
        count: how many frames at most.
        protocol: how to score.
        against: a prior whose maps stand for the truth.
        scored: False where times alone are wanted.

    Raises:
        DataError: there is no truth, or it has another size than the images.
    """
    if not scored:
        return Judge(drive, tuple(pick_middles(indices, count)), protocol, None)
    known = [index for index in indices if _has_truth(drive, index, against)]
    if not known:
        raise _no_truth(drive, indices, against)
    chosen = tuple(pick_middles(known, count))
    truth = Frame.truth if against is None else _reader(against)
    _check_size(drive[chosen[0]], truth)
    return Judge(drive, chosen, protocol, truth)


def _has_truth(drive: Drive, index: int, against: Prior | None) -> bool:
    return drive[index].has("truth") if against is None else against.has(drive.ids[index])


def _no_truth(drive: Drive, indices: Sequence[int], against: Prior | None) -> DataError:
    """Say why there is nothing to score against, and what to do."""
    if against is not None:
        return DataError(f"{against.folder}: has none of {drive.name}'s {len(indices)} frames: build them first")
    frame = drive[indices[0]]
    why = frame.missing.get("truth", "this drive has none")
    others = "score against a prior by --against cache/DRIVE/lidar-KEY, or measure times alone by --times-only"
    return DataError(f"{drive.name}: no true depth: {why}; or {others}")


def _reader(prior: Prior) -> Callable[[Frame], Depth]:
    return lambda frame: prior.read(frame.id)


def _check_size(frame: Frame, truth: Callable[[Frame], Depth]) -> None:
    """Raise DataError where the truth has another size than the image."""
    shape = truth(frame).depth_m.shape
    if shape != frame.camera.size:
        sizes = [f"{width}x{height}" for height, width in (shape, frame.camera.size)]
        raise DataError(f"frame {frame.id}: the truth is {sizes[0]}, the image {sizes[1]}: name the truth of this size")
