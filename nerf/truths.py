"""Ground truth that held-out views' depth is scored against."""

from collections.abc import Sequence

from eval.protocol import NO_TRUTH
from priors.methods.lidar import Lidar
from priors.types import Depth, Drive


class Truths:
    """The true depth of a drive's frames: its own, or else one LiDAR sweep's; decided for all frames at once."""

    def __init__(self, drive: Drive, ids: Sequence[str]) -> None:
        self._frames = {id_: position for position, id_ in enumerate(drive.ids)}
        self._drive = drive
        first = [drive[self._frames[id_]] for id_ in ids]
        self.label = NO_TRUTH
        """none, annotated or lidar: which truth it is."""
        self.why_none = ""
        if first and all(frame.has("truth") for frame in first):
            self.label = "annotated"
        elif first and all(frame.has("sweep") for frame in first):
            self.label = "lidar"
        elif first:
            self.why_none = f"no depth figures: {first[0].missing.get('truth', 'this drive has no true depth')}"

    def __call__(self, id_: str) -> Depth | None:
        """Return a frame's true depth; None where there is none."""
        if self.label == NO_TRUTH:
            return None
        frame = self._drive[self._frames[id_]]
        if self.label == "annotated":
            return frame.truth()
        if frame.sweep() is None:
            return None  # the scanner missed this frame
        return Lidar(sweeps=1).resolve(frame)(frame)
