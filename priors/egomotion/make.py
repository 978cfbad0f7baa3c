"""Refined poses of a drive, made once and kept beside its priors."""

from collections.abc import Callable, Collection
from pathlib import Path

from priors import refined_poses
from priors.drives import poses_of
from priors.egomotion.refine import refine
from priors.egomotion.sight import Eyes
from priors.errors import DataError
from priors.refined_poses import Recipe, RefinedPoses
from priors.types import Drive, Frame


def make(
    drive: Drive,
    eyes: Eyes,
    left_out: Collection[str] = (),
    cache: Path = Path("cache"),
    on_frame: Callable[[], None] = lambda: None,
) -> RefinedPoses:
    """Refine a drive's poses, or load them where they lie already.

    Args:
        drive: with its own poses.
        eyes: what tells depth; see `open_eyes`.
        left_out: ids of frames whose images and sweeps take no part.
        cache: they lie in its folder of the drive.
        on_frame: called after each frame.

    Raises:
        DataError: fewer than two frames have a pose, or images show no motion.
    """
    if poses_of(drive.describe()) == "refined":
        raise DataError(f"{drive.name}: its poses are refined already: open it with its own")
    frames = posed_frames(drive)
    out = [frame.id for frame in frames if frame.id in left_out]
    recipe = Recipe(drive.describe(), drive.fingerprint(), [frame.id for frame in frames], out, eyes.source)
    folder = recipe.folder(cache / drive.name)
    if (folder / refined_poses.RECORD).exists():
        return refined_poses.load(folder)
    if len(frames) < 2:
        raise DataError(
            f"{drive.name}: {len(frames)} frames have a pose: expected 2 or more (`priors check` tells more)"
        )
    refined = refine(frames, eyes, set(out), on_frame)
    found = refined_poses.summarise(refined.before_px, refined.after_px, refined.seen)
    refined_poses.write(folder, recipe, refined.T_world_cam, found)
    return refined_poses.load(folder)


def posed_frames(drive: Drive) -> list[Frame]:
    """Return the frames that have a pose."""
    frames = []
    for index in range(len(drive)):
        try:
            frame = drive[index]
        except DataError:
            continue  # it is told where the frame is used
        if frame.T_world_cam is not None:
            frames.append(frame)
    return frames
