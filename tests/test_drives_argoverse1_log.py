"""A whole Argoverse 1 tracking log: nine cameras, labels and maps beside, rings at 30 Hz, the pair at 5 Hz."""

import json
from pathlib import Path

import numpy as np
import pytest
from factories import AV_FORWARD_WXYZ, AV_START_NS, AV_STEREO, av_camera, write_argoverse_tracking, write_av_pose

from priors import codecs
from priors.check import check
from priors.drives import DriveOptions, open_drive

pytestmark = pytest.mark.datasets
RINGS = ("front_center", "front_left", "front_right", "side_left", "side_right", "rear_left", "rear_right")
STEP_NS = 33_333_333


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """The folders and files that the data set's release has in a log."""
    folder = write_argoverse_tracking(
        tmp_path / "argoverse-tracking" / "train1" / "3d20ae25-5b29-320d-8bae-f03e9dc177b9"
    )
    cameras = [av_camera(name, *values) for name, values in AV_STEREO.items()]
    for place, name in enumerate(RINGS):
        height_m = 1.4 + 0.01 * place
        cameras.append(av_camera(f"ring_{name}", 1400.0, 960.0, 600.0, AV_FORWARD_WXYZ, [1.6, 0, height_m]))
        for n in range(3):
            time = AV_START_NS + n * STEP_NS
            image = np.full((1200, 1920, 3), 40 + 10 * place, np.uint8)
            codecs.write_image(folder / f"ring_{name}" / f"ring_{name}_{time}.jpg", image)
            write_av_pose(folder, time, 10.0 * (time - AV_START_NS) * 1e-9)
    (folder / "vehicle_calibration_info.json").write_text(
        json.dumps({"camera_data_": cameras, "vehicle_SE3_up_lidar_": {}})
    )
    (folder / "city_info.json").write_text('{"city_name": "MIA"}')
    labels = folder / "per_sweep_annotations_amodal"
    labels.mkdir()
    (labels / f"tracked_object_labels_{AV_START_NS + 30_000_000}.json").write_text("[]")
    (folder / "track_labels_amodal").mkdir()
    (folder / "track_labels_amodal" / "0a0a0a0a-0000-0000-0000-000000000000.json").write_text("{}")
    return folder


def test_every_camera_opens_with_its_sweeps_and_poses(log: Path) -> None:
    for name in (*AV_STEREO, *(f"ring_{each}" for each in RINGS)):
        drive = open_drive(log, options=DriveOptions(camera=name))
        assert len(drive) == (2 if name in AV_STEREO else 3 + (name == "ring_front_center"))
        frame = drive[0]
        assert frame.T_world_cam is not None and frame.has("other") == (name in AV_STEREO)
        sweep = frame.sweep()
        assert sweep is not None and len(sweep.xyz_m) == 3
    heights_m = [open_drive(log, options=DriveOptions(camera=f"ring_{each}"))[0].pose()[2, 3] for each in RINGS]
    assert len({round(float(height), 3) for height in heights_m}) == len(RINGS)  # each by its own calibration


def test_the_root_holds_it_and_the_audit_reads_it(log: Path) -> None:
    root = log.parents[1]
    drive = open_drive(root, options=DriveOptions(drive=log.name))
    assert drive.name.endswith(log.name) or log.name in drive.name
    assert not [finding for finding in check(drive) if "labels" in finding.message or "city_info" in finding.message]
