"""Track: where a drive's camera was, in a frame of the view's own.

A browser draws in float32. Poses in UTM are 5,000,000 m from their origin, where float32 steps by half a metre. So an
origin near the path is taken off in float64 before anything becomes float32.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from priors.types import Camera, Drive, Matrix

FAR_M = 1000.0
"""An origin farther than this from the drive's own is worth telling."""


@dataclass(frozen=True)
class Track:
    """The poses of some frames of a drive."""

    ids: list[str]
    """Frame ids, in time order."""
    T_world_cam: list[Matrix | None]
    """(4, 4) each, the drive's own; None where a frame has no pose, or one that is not finite."""
    origin_m: npt.NDArray[np.float64]
    """(3,) what is taken off, metres: the place of the first posed camera; zeros without poses."""
    posed: bool
    """Whether any frame has a pose. Where none has, every frame is shown at the origin, one at a time."""

    @classmethod
    def of(cls, drive: Drive, indices: list[int]) -> "Track":
        """Collect the poses of a drive's frames."""
        poses = [_finite(drive[index].T_world_cam) for index in indices]
        first = next((pose for pose in poses if pose is not None), None)
        origin_m = np.zeros(3) if first is None else first[:3, 3].copy()
        return cls([drive.ids[index] for index in indices], poses, origin_m, first is not None)

    def pose(self, position: int) -> Matrix | None:
        """Return a frame's T_view_cam (4, 4), metres from the origin; None where it cannot be placed."""
        T_world_cam = self.T_world_cam[position]
        if T_world_cam is None:
            return None if self.posed else np.eye(4)
        return self.shifted(T_world_cam)

    def shifted(self, T_world_a: Matrix) -> Matrix:
        """Return T_view_a of a T_world_a (4, 4)."""
        T_view_a = np.array(T_world_a, dtype=np.float64)
        T_view_a[:3, 3] -= self.origin_m
        return T_view_a

    def unshifted(self, T_view_a: Matrix) -> Matrix:
        """Return T_world_a of a T_view_a (4, 4): the drive's own coordinates."""
        T_world_a = np.array(T_view_a, dtype=np.float64)
        T_world_a[:3, 3] += self.origin_m
        return T_world_a

    def path_m(self) -> npt.NDArray[np.float64]:
        """Return the places (n, 3) of the frames that have one, metres from the origin, in time order."""
        poses = [self.pose(position) for position in range(len(self.ids))]
        return np.array([pose[:3, 3] for pose in poses if pose is not None]).reshape(-1, 3)

    def up(self) -> npt.NDArray[np.float64]:
        """Return the direction (3,) that is up for the cameras, of length 1: the mean of their -y axes."""
        poses = [self.pose(position) for position in range(len(self.ids))]
        mean = np.mean([-pose[:3, 1] for pose in poses if pose is not None], axis=0)
        length = float(np.linalg.norm(mean))
        return mean / length if length > 1e-6 else np.array([0.0, -1.0, 0.0])

    def far(self) -> bool:
        """Tell whether the origin that was taken off is worth telling."""
        return float(np.abs(self.origin_m).max()) > FAR_M


def field_of_view(camera: Camera) -> tuple[float, float]:
    """Return a camera's vertical field of view, radians, and its width over its height, as one that looks straight on.

    The principal point of a real camera is a little beside the middle; a viewer's is in the middle.
    """
    height, width = camera.size
    return 2 * float(np.arctan(height / (2 * camera.K[1, 1]))), float(width / height * camera.K[1, 1] / camera.K[0, 0])


def fitting_fov(camera: Camera, aspect: float) -> float:
    """Return the vertical field of view, radians, of a window (width over height) that shows the whole of a camera."""
    vertical, own = field_of_view(camera)
    return vertical if aspect >= own else 2 * float(np.arctan(np.tan(vertical / 2) * own / aspect))


def quaternion(T_a_b: Matrix) -> tuple[float, float, float, float]:
    """Return the rotation of a pose (4, 4) as w, x, y, z."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = (float(value) for value in Rotation.from_matrix(T_a_b[:3, :3]).as_quat())
    return w, x, y, z


def _finite(pose: Matrix | None) -> Matrix | None:
    return None if pose is None or not np.isfinite(pose).all() else pose
