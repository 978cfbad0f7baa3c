"""KITTI submissions: depth completion and prediction, stereo 2012 and 2015, as the devkits' readme.txt ask for them.

| benchmark  | names in the zip            | images | values                                    |
|------------|-----------------------------|--------|-------------------------------------------|
| completion | 0000000000.png, in its root | 1000   | depth, metres x 256                       |
| prediction | the same                    | 500    | the same                                  |
| stereo2015 | disp_0/000000_10.png        | 200    | disparity of the left image, pixels x 256 |
| stereo2012 | 000000_10.png, in its root  | 195    | the same                                  |

Values are uint16 PNG of one channel, rounded; 0 = no value, which the devkits fill from the neighbours. A disparity so
small that it would be 0 is written as 1. The images have the size of the benchmark's own.
"""

import re
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from eval.files import replacing
from priors import codecs
from priors.errors import DataError
from priors.export import place
from priors.export.fusion import Step
from priors.export.views import View, Views
from priors.geometry import convert_disparity

Benchmark = Literal["completion", "prediction", "stereo2012", "stereo2015"]
CAMERAS_2012 = ("image_0", "image_1", "colored_0", "colored_1")
"""Cameras of stereo 2012, by the folders of its download."""
DATE = (1980, 1, 1, 0, 0, 0)
"""Of every member: the same maps give the same bytes."""


@dataclass(frozen=True)
class Rules:
    """What a benchmark's server takes."""

    ids: re.Pattern[str]
    """Frame ids that belong to the benchmark; the group is the image's number."""
    names: str
    """Name in the zip, by the image's number."""
    count: int
    """Test images; numbers begin at 0."""
    size: tuple[int, int] | None = None
    """(height, width) of the test images; None where they differ."""

    @property
    def holds(self) -> str:
        """What the values are."""
        return "disparity of the left image, pixels x 256" if self.ids is PAIR else "camera-z depth, metres x 256"


SINGLE, PAIR = re.compile(r"(\d{10})"), re.compile(r"(\d{6})(?:_10)?")
CROPPED = (352, 1216)
MOST_TOLD = 5
"""Faults of an archive that are told one by one."""
RULES: dict[Benchmark, Rules] = {
    "completion": Rules(SINGLE, "{:010d}.png", 1000, CROPPED),
    "prediction": Rules(SINGLE, "{:010d}.png", 500, CROPPED),
    "stereo2012": Rules(PAIR, "{:06d}_10.png", 195),
    "stereo2015": Rules(PAIR, "disp_0/{:06d}_10.png", 200),
}


def benchmark_of(views: Views) -> Benchmark:
    """Return the benchmark that the frames' ids, the camera and the method are of; DataError where the ids are of none.

    Depth by mono is for the prediction benchmark, all other depth for completion.
    """
    if all(SINGLE.fullmatch(id_) for id_ in views.ids):
        return "prediction" if views.prior.method == "mono" else "completion"
    if all(PAIR.fullmatch(id_) for id_ in views.ids):
        return "stereo2012" if views.drive.describe().get("camera") in CAMERAS_2012 else "stereo2015"
    raise DataError(
        f"{views.drive.name}: frame {views.ids[0]}: KITTI's test images are called 0000000000 (depth) or 000000_10 "
        "(stereo): export a prior of such images"
    )


def write(path: Path, views: Views, benchmark: Benchmark, on_view: Step = lambda: None) -> list[str]:
    """Write the archive, atomically.

    Returns:
        What to tell the user, a line each: what it holds, then what a server would refuse.

    Raises:
        DataError: an id is not of the benchmark, no map can be read, or a disparity cannot be made.
        OSError: it cannot be written.
    """
    rules, count, too_large = RULES[benchmark], 0, 0
    with replacing(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        archive.comment = "\n".join([*place.heading(views), f"{rules.holds}, 16-bit PNG, 0 = no value"]).encode()
        for view in views:
            codes, lost = _codes(view, benchmark)
            done, data = cv2.imencode(".png", codes)
            if not done:
                raise DataError(f"{path}: OpenCV cannot write a 16-bit PNG")
            archive.writestr(zipfile.ZipInfo(_name(view, rules), DATE), data.tobytes())
            count, too_large = count + 1, too_large + lost
            on_view()
    lines = [f"{count} maps ({benchmark}: {rules.holds}): {path}"]
    lines += [f"{too_large} values are larger than 255.99 and have no value"] if too_large else []
    return [*lines, *(f"KITTI's server refuses it: {fault}" for fault in check(path, benchmark))]


def check(path: Path, benchmark: Benchmark) -> list[str]:
    """Return what the benchmark's server would refuse of an archive, a line each: names, files, sizes, completeness."""
    rules, wrong = RULES[benchmark], []
    wanted = {rules.names.format(number) for number in range(rules.count)}
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        if missing := len(wanted - set(names)):
            wrong.append(f"{missing} of {rules.count} test images are missing")
        for name in names:
            codes = cv2.imdecode(np.frombuffer(archive.read(name), np.uint8), cv2.IMREAD_UNCHANGED)
            if name not in wanted:
                wrong.append(f"{name}: no test image is called so")
            elif codes is None or codes.dtype != np.uint16 or codes.ndim != 2:
                wrong.append(f"{name}: no 16-bit PNG of one channel")
            elif rules.size is not None and codes.shape != rules.size:
                wrong.append(f"{name}: is {codes.shape[1]}x{codes.shape[0]}, not {rules.size[1]}x{rules.size[0]}")
            elif not codes.any():
                wrong.append(f"{name}: has no value")
    more = len(wrong) - MOST_TOLD
    return wrong if more <= 0 else [*wrong[:MOST_TOLD], f"and {more} more"]


def _name(view: View, rules: Rules) -> str:
    found = rules.ids.fullmatch(view.frame.id)
    if found is None:
        wanted = rules.names.format(0).rpartition("/")[2]
        raise DataError(f"frame {view.frame.id}: this benchmark's images are called like {wanted}")
    return rules.names.format(int(found[1]))


def _codes(view: View, benchmark: Benchmark) -> tuple[npt.NDArray[np.uint16], int]:
    """Return a view's values as codes (height, width), and how many were too large."""
    if RULES[benchmark].ids is SINGLE:
        return codecs.encode_depth(view.depth.depth_m)
    frame = view.frame
    if frame.baseline_m is None or frame.side != "left":
        raise DataError(f"frame {frame.id}: KITTI wants disparities of a pair's left camera: build by --camera")
    disparity_px = convert_disparity(view.depth.depth_m, frame.camera.fx, frame.baseline_m)
    codes, too_large = codecs.encode_depth(disparity_px)
    return np.where((codes == 0) & (disparity_px > 0) & (disparity_px < 1), np.uint16(1), codes), too_large
