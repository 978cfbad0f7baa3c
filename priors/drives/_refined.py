"""A drive with refined poses: all else is the drive's own."""

from dataclasses import replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from priors.drive_around import DriveAround
from priors.drives._files import revise
from priors.geometry import invert
from priors.poses import readable
from priors.refined_poses import RefinedPoses
from priors.types import Drive, Frame, Matrix, Sweep


class RefinedDrive(DriveAround):
    """Frames and sweeps of a drive, placed by refined poses; frames that these lack have no pose."""

    def __init__(self, drive: Drive, poses: RefinedPoses) -> None:
        super().__init__(drive)
        self.poses = poses

    def describe(self) -> dict[str, Any]:
        """Return what reopens the drive and these poses."""
        return {**self.drive.describe(), "poses": "refined", "poses_from": str(self.poses.folder.resolve())}

    def fingerprint(self) -> str:
        """Digest of what the drive's own covers, and of these poses."""
        return revise(self.drive.fingerprint(), self.poses.digest)

    def scans(self) -> dict[str, list[str]]:
        """List the frame ids that each kind of file has, where the drive tells them."""
        scans = getattr(self.drive, "scans", dict)
        return dict(scans())

    def frame(self, index: int) -> Frame:
        """Return a frame with its refined pose, or with the reason why it has none."""
        frame, T_world_cam = self.drive[index], self.poses.T_world_cam.get(self.ids[index])
        missing = dict(frame.missing)
        if T_world_cam is None:
            missing["pose"] = f"{self.poses.folder}: no refined pose of this frame: run `priors poses` on all frames"
        readers = dict(frame.readers)
        if frame.has("sweep"):
            readers["sweep"] = partial(self._sweep, index)
        return replace(frame, T_world_cam=T_world_cam, posed="camera", missing=missing, readers=readers)

    def _sweep(self, index: int, offset: int = 0) -> Sweep | None:
        """Read a sweep, and place it as the frame nearest to it was moved."""
        sweep: Sweep | None = self.drive[index].sweep(offset)
        if sweep is None or sweep.T_world_lidar is None:
            return sweep
        nearest = index if offset == 0 else self._nearest(sweep.T_world_lidar, index, abs(offset))
        before, after = self._recorded[nearest], self.poses.T_world_cam.get(self.ids[nearest])
        if before is None or after is None:
            return replace(sweep, T_world_lidar=None)
        return replace(sweep, T_world_lidar=after @ invert(before) @ sweep.T_world_lidar)

    def _nearest(self, T_world_lidar: Matrix, index: int, reach: int) -> int:
        """Return the frame whose own LiDAR, as recorded, is nearest to a sweep's place; of `reach` frames around.

        Sweeps are not always frames: Argoverse has two a frame. The reach keeps a path that crosses itself apart.
        """
        around = range(max(0, index - reach), min(len(self), index + reach + 1))
        places = {n: T[:3, 3] for n in around if (T := self._recorded[n]) is not None}
        own, T_cam_lidar = self._recorded[index], self.drive[index].T_cam_lidar
        if own is None or T_cam_lidar is None or not places:
            return index
        camera_m = (T_world_lidar @ invert(T_cam_lidar))[:3, 3]
        return min(places, key=lambda n: float(np.linalg.norm(places[n] - camera_m)))

    @cached_property
    def _recorded(self) -> list[Matrix | None]:
        """The drive's own poses."""
        poses = readable(range(len(self.drive)), lambda index: self.drive[index].T_world_cam)
        return [poses.get(index) for index in range(len(self.drive))]
