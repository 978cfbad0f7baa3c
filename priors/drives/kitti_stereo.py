"""KITTI stereo 2012 and 2015, as downloaded: pairs that have nothing to do with each other, each with its truth.

    2015  training/{image_2,image_3}/000000_10.png, disp_occ_0/, disp_noc_0/, obj_map/
          training/calib_cam_to_cam/000000.txt      also in data_scene_flow_calib/ beside
    2012  training/{image_0,image_1,colored_0,colored_1}/000000_10.png, disp_occ/, disp_noc/
          training/calib/000000.txt
    both  testing/, without truth
    velodyne/000000_10.bin      not in the download: the raw sweep of a pair, put beside by its user

Quirks kept here (devkits' readmes of both years; Menze and Geiger, CVPR 2015):
- A "drive" is a split. Its frames are of many drives and days: there are no poses, no times and no motion between them.
- Only images of frame number 10 are the benchmark's. 11 and the others of the multi-view download belong to the optical
  flow; disp_occ_1 is the second pair's disparity as the first image sees it, and no image's depth: it is not read.
- Each frame has a calibration and an image size of its own. Instead, one calib_cam_to_cam.txt in the split's folder, or
  above it, may serve all frames.
- Truth is disparity: uint16, px x 256, 0 = none, of the left camera. occ has all pixels and noc those that the right
  image shows too.
- 2012's truth is of the grey pair. The left colour camera stands 6 cm to the left of the grey one, which is a ninth of
  the baseline: a point of 45 px of disparity lies 5 px beside its truth. So the colour pair has none, unless --truth
  names it.
- A sweep is placed by calib_velo_to_cam/000000.txt, or by one calib_velo_to_cam.txt for all, which lie where the
  cameras' calibration does. It is not compensated for the car's motion, and nothing here tells the motion.
- obj_map (2015): 0 = background, else the number of a car. The benchmark scores the two apart.
"""

import re
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from priors import codecs
from priors.drives import DriveOptions
from priors.drives._camera_drive import Files, Readers
from priors.drives._files import (
    IMAGE_SUFFIXES,
    check_size,
    choose,
    need,
    read_key_values,
    search,
    split_projection,
    stems,
)
from priors.drives._rigs import KITTI
from priors.drives._single_frames import SinglePairs, has_file
from priors.drives.kitti_raw import read_rigid
from priors.errors import DataError
from priors.geometry import convert_disparity
from priors.types import Camera, Depth, Mask, Matrix

BELOW = 2
"""How many levels below the data set's own folder its splits are: data_scene_flow/, then a split."""
PAIRS = (("image_2", "image_3"), ("image_0", "image_1"), ("colored_0", "colored_1"))
NUMBERS = {name: 2 * (pair != PAIRS[1]) + side for pair in PAIRS for side, name in enumerate(pair)}
"""Camera -> its number in the calibration."""
TRUTHS = {"image_2": ("disp_occ_0", "disp_noc_0"), "image_0": ("disp_occ", "disp_noc")}
"""Folders of truth, the first is scored unless --truth names another."""
REFERENCE = re.compile(r"\d{6}_10\.(png|jpe?g)", re.IGNORECASE)
GREY = {"colored_0": "image_0"}
"""Left colour camera -> the grey camera that the truth of its pairs is of."""
CAMERAS, LIDAR = "calib_cam_to_cam", "calib_velo_to_cam"
"""What the files and folders of calibration are called; 2012 has another name for the cameras'."""
CALIBRATION = "download data_scene_flow_calib.zip (2015), or the calib folder of data_stereo_flow.zip (2012)"


def recognises(path: Path) -> bool:
    """Tell whether the folder is a split, or holds splits."""
    return bool(search(path, is_drive, BELOW))


def is_drive(folder: Path) -> bool:
    """Tell whether the folder is itself a split: one of its cameras has images of frame number 10."""
    return any(has_file(folder / name, REFERENCE) for name in NUMBERS)


def open_drive(path: Path, options: DriveOptions) -> "KittiStereo":
    """Open one split; path is its folder, or the data set's with options.drive."""
    folder = choose(search(path, is_drive, BELOW), options.drive, path, "a split (training/image_2/000000_10.png)")
    found = [left for left, _ in PAIRS if has_file(folder / left, REFERENCE)]
    return KittiStereo(folder, options.camera or next(iter(found), "image_2"), options.truth)


class KittiStereo(SinglePairs):
    """One camera's view of the pairs of a split."""

    pairs = PAIRS

    def __init__(self, folder: Path, camera: str, truth: Path | None = None) -> None:
        super().__init__(folder, camera, truth)
        partner = self.paired_camera()
        self.images = _references(self.folder / camera)
        if not self.images:
            raise DataError(f"{self.folder / camera}: no images NNNNNN_10.png: choose another --camera, or download it")
        self.others = {id_: path for id_, path in _references(self.folder / partner).items() if id_ in self.images}
        self._calibration = lru_cache(maxsize=None)(_read_calibration)
        self._truth_folder = self._find_truth()
        self.maps = {} if self._truth_folder is None else {"truth": stems(self._truth_folder, [".png"])}
        self._objects = stems(self.folder / "obj_map", [".png"]) if camera == "image_2" else {}
        self.sweeps = stems(self.folder / "velodyne", [".bin"])
        self.camera, self.baseline_m = self.first_readable()
        self.rig = KITTI

    @property
    def name(self) -> str:
        """The data set with its year, and the split; cameras other than the year's usual one are named too."""
        year = "2015" if self.camera_name in PAIRS[0] else "2012"
        usual = self.camera_name in TRUTHS
        return f"kitti_stereo{year}_{self.folder.name}" + ("" if usual else f"-{self.camera_name}")

    def describe(self) -> dict[str, Any]:
        """Return what a manifest records: also which truth, of which there is more than one."""
        named = {} if self._truth_folder is None else {"truth_maps": self._truth_folder.name}
        return {**super().describe(), **named}

    def sources(self) -> list[Path]:
        """List the calibration files of all frames."""
        files = [path for id_ in self.ids if (path := self._find_calibration(id_)) is not None]
        files += [path for id_ in self.ids if (path := self._lidar_file(id_)) is not None]
        return list(dict.fromkeys(files))

    def readers(self, id_: str) -> Readers:
        """Return what can be read of a frame: also which pixels are cars."""
        readers = super().readers(id_)
        if id_ in self._objects:
            readers["foreground"] = lambda: self._read_objects(id_)
        return readers

    def files(self, id_: str) -> Files:
        """Return which file each reader reads: also the cars'."""
        files: Files = {"foreground": lambda: self._objects.get(id_)}
        return super().files(id_) | files

    def can_place(self, id_: str) -> bool:
        """Tell whether there is a file that says where a frame's sweep was taken."""
        return self._lidar_file(id_) is not None

    def notes(self) -> list[str]:
        """Say where the truth is another camera's."""
        if self._truth_folder is None or self.camera_name not in GREY:
            return []
        right_m, note = self._grey_right_m(self.ids[0]), f"truth is of {GREY[self.camera_name]}"
        note += f", which stands {100 * right_m:.0f} cm to the right"
        if self.baseline_m is not None:
            note += f": a point of 45 px of disparity lies {45 * right_m / self.baseline_m:.1f} px beside it"
        return [note]

    def missing(self, id_: str) -> dict[str, str]:
        """Say why a reader is not there, and what to do."""
        left = next(left for left, right in PAIRS if self.camera_name in (left, right))
        truth = f"{self.folder}: no {' or '.join(TRUTHS.get(left, ('disp_occ',)))}: test images have no public truth"
        if self._truth_folder is not None:
            truth = f"{self._truth_folder}: no map {id_}.png: download the pairs again"
        elif self.side == "right":
            truth = f"truth is of the left camera: leave out --camera, or choose {left}"
        elif left not in TRUTHS:
            right_cm = 100 * self._grey_right_m(id_)
            truth = f"truth of 2012 is of the grey camera, {right_cm:.0f} cm to the right: choose --camera {GREY[left]}"
            truth += f", or take it as it is: --truth {self.folder / 'disp_occ'}"
        sweep = "KITTI's stereo benchmark has no sweeps: use stereo, or mono"
        if id_ in self.sweeps:
            sweep = f"{self._lidar_places(id_)[0]}: no such file, so the sweep cannot be placed: {CALIBRATION}"
        elif self.sweeps:
            sweep = f"{self.folder / 'velodyne'}: no sweep {id_}.bin: put it there"
        return {
            **super().missing(id_),
            "other": f"{self.folder}/{self.partner}: no image {id_}: stereo needs both: download the pairs again",
            "sweep": sweep,
            "truth": truth,
            "sparse": "KITTI's stereo benchmark has no sparse depth maps",
            "sky": "KITTI has no sky masks",
            "foreground": f"{self.folder / 'obj_map'}: no map {id_}.png: download data_scene_flow.zip",
        }

    def camera_of(self, id_: str) -> Camera:
        """Return the frame's own camera."""
        K, _ = self.projection(id_, self.camera_name)
        size = self._calibration(self.calibration_file(id_)).get(f"S_rect_0{NUMBERS[self.camera_name]}")
        if size is not None and size.size == 2:
            return Camera(K, (int(size[1]), int(size[0])))
        return Camera(K, self.size_of(self.images[id_]))

    def T_cam_lidar(self, id_: str) -> Matrix | None:
        """Return the LiDAR's place by the frame's own calibration; None where it has no sweep."""
        lidar = self._lidar_file(id_)
        T_cam0_velo = None if lidar is None else read_rigid(lidar)
        if T_cam0_velo is None:
            return None
        cameras, R_rect = self.calibration_file(id_), np.eye(4)
        R_rect[:3, :3] = need(self._calibration(cameras), "R_rect_00", 9, cameras).reshape(3, 3)
        return np.asarray(self.projection(id_, self.camera_name)[1] @ R_rect @ T_cam0_velo)

    def read_map(self, path: Path, id_: str) -> Depth:
        """Read a disparity map as depth."""
        camera, baseline_m = self.camera_of(id_), self.baseline_of(id_)
        disparity_px = check_size(codecs.read_depth_png(path), path, camera)
        if baseline_m is None:
            raise DataError(f"{path}: disparity without the other image {self.partner}/{id_}: download it")
        return Depth(convert_disparity(disparity_px, camera.fx, baseline_m))

    def _grey_right_m(self, id_: str) -> float:
        """Return how far to the right of a left colour camera the grey one stands, by the calibration, metres."""
        colour, grey = (self.projection(id_, name)[1][0, 3] for name in next(iter(GREY.items())))
        return float(colour - grey)

    def _read_objects(self, id_: str) -> Mask:
        path = self._objects[id_]
        objects = codecs.read_image(path)
        if objects.ndim != 2:
            raise DataError(f"{path}: expected a one-channel map of object numbers: download it again")
        return np.asarray(check_size(objects, path, self.camera_of(id_)) > 0)

    def projection(self, id_: str, camera: str) -> tuple[Matrix, Matrix]:
        """Return K (3, 3) and T_cam_cam0 (4, 4) of a camera at a frame, metres."""
        path, number = self.calibration_file(id_), NUMBERS[camera]
        values = self._calibration(path)
        key = f"P{number}" if f"P{number}" in values else f"P_rect_0{number}"
        return split_projection(need(values, key, 12, path).reshape(3, 4), key, path)

    def calibration_file(self, id_: str) -> Path:
        """Return the frame's calibration: its own, or the one that serves all frames."""
        found = self._find_calibration(id_)
        if found is None:
            wanted = self._calibration_places(id_)[0]
            raise DataError(f"{wanted}: no such file: {CALIBRATION}")
        return found

    def _find_calibration(self, id_: str) -> Path | None:
        return next((path for path in self._calibration_places(id_) if path in self._shared or path.is_file()), None)

    @cached_property
    def _shared(self) -> set[Path]:
        """Calibration files for all frames that are there."""
        places = [above / f"{name}.txt" for name in (CAMERAS, LIDAR) for above in (self.folder, self.folder.parent)]
        return {path for path in places if path.is_file()}

    def _calibration_places(self, id_: str) -> list[Path]:
        """List where the frame's calibration may be, the likeliest first."""
        return self._places(id_, CAMERAS if self.camera_name in PAIRS[0] else "calib", CAMERAS)

    def _lidar_file(self, id_: str) -> Path | None:
        """Return the file that tells where a frame's sweep was taken; None where there is no sweep, or no such file."""
        if id_ not in self.sweeps:
            return None
        return next((path for path in self._lidar_places(id_) if path in self._shared or path.is_file()), None)

    def _lidar_places(self, id_: str) -> list[Path]:
        """List where the place of the LiDAR may be told, the likeliest first."""
        return self._places(id_, LIDAR, LIDAR)

    def _places(self, id_: str, inside: str, for_all: str) -> list[Path]:
        """List where a frame's own file, or the one for all frames, may be."""
        file, split = f"{id_[:6]}.txt", self.folder.name
        calibs = [above / zip_ / split for above in list(self.folder.parents)[:2] for zip_ in (
            "data_scene_flow_calib", "data_stereo_flow_calib", "calib")]  # fmt: skip
        own = [folder / inside / file for folder in (self.folder, *calibs)]
        return [*own, *(path / f"{for_all}.txt" for path in (self.folder, self.folder.parent))]

    def _find_truth(self) -> Path | None:
        """Return the folder of the camera's truth; DataError where --truth names one that has none."""
        names = TRUTHS.get(self.camera_name, () if self.side == "right" else ("disp_occ", "disp_noc"))
        if self.truth is None:
            own = [self.folder / name for name in TRUTHS.get(self.camera_name, ())]
            return next((path for path in own if path.is_dir()), None)
        split = self.folder.name
        places = [self.truth, *(self.truth / name for name in names), *(self.truth / split / name for name in names)]
        found = next((path for path in places if set(stems(path, [".png"])) & set(self.images)), None)
        if found is None:
            raise DataError(f"{self.truth}: --truth should hold disparity maps such as {self.ids[0]}.png, found none")
        return found


def _references(folder: Path) -> dict[str, Path]:
    """Map frame id to image, for those of frame number 10."""
    images = stems(folder, IMAGE_SUFFIXES)
    return {id_: path for id_, path in images.items() if REFERENCE.fullmatch(path.name)}


def _read_calibration(path: Path) -> dict[str, Any]:
    return dict(read_key_values(path))
