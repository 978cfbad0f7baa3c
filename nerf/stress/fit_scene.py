"""The scene of fits under stress: a drive of the user's with a right prior, or a small street with its own truth."""

from pathlib import Path

from nerf.guide import TRUTH
from nerf.prepare import SceneConfig, open_scene
from nerf.scene import Scene
from nerf.truths import Truths
from priors import cache
from priors.drives import open_drive
from priors.errors import DataError
from priors.street.write import write_street

FRAMES, SEED, SIZE = 40, 11, (128, 416)
"""Of the street: ten training views."""


def opened(data: Path | None, prior: Path | None, folder: Path) -> tuple[Scene, Truths]:
    """Return the scene, sparse views, and the truth of its held-out views.

    Args:
        data: a drive's folder; None: a street is written.
        prior: a prior's folder; None: the drive's own true depth.
        folder: where the scene's arrays, and the street, are kept.

    Raises:
        DataError: the drive cannot be read, or nothing tells the depth of its held-out views.
    """
    if data is None:
        data = folder / "street"
        write_street(data, FRAMES, SEED, SIZE, workers=2)
    drive = open_drive(data)
    scene = open_scene(drive, TRUTH if prior is None else cache.only(prior), SceneConfig("sparse"), folder / "scenes")
    truths = Truths(drive, [scene.ids[position] for position in scene.test])
    if not scene.test or truths.why_none:
        raise DataError(f"{scene.name}: {truths.why_none or 'no frame is held out: take 10 frames or more'}")
    return scene, truths
