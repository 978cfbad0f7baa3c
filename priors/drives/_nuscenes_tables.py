"""nuScenes' tables: which files a scene's sensors wrote, when, and from where (the devkit's schema).

A table is a JSON list of records that name each other by tokens:

    scene -> sample (2 Hz) <- sample_data (one file of one sensor) -> ego_pose, calibrated_sensor -> sensor (a channel)
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from priors.drives._rectified import to_pose
from priors.errors import DataError
from priors.text import read_text
from priors.types import Matrix

NAMES = ("scene", "sample", "sample_data", "ego_pose", "calibrated_sensor", "sensor")
MEND = "unpack the metadata again"
Record = dict[str, Any]


@dataclass(frozen=True)
class Taken:
    """One file of one sensor."""

    file: str
    """Below the data set's folder."""
    time_us: int
    ego_pose: str
    """Token."""
    calibrated_sensor: str
    """Token."""
    size: tuple[int, int]
    """(height, width) of an image; (0, 0) of a sweep."""


def versions(root: Path) -> list[Path]:
    """List the folders of tables in a data set's folder: v1.0-mini, say."""
    return sorted(path for path in root.glob("v1.*") if any((path / f"{name}.json").is_file() for name in NAMES))


class Tables:
    """The tables of one version; each is read when it is asked for."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @cached_property
    def scenes(self) -> dict[str, str]:
        """Token by name."""
        return {str(self._field("scene", record, "name")): token for token, record in self._records("scene")}

    def taken(self, scene: str) -> dict[str, list[Taken]]:
        """Return what each channel took in a scene (its token), keyframes and others, in time order, by its name.

        Raises:
            DataError: a table is missing or damaged, or names a record that is not there.
        """
        samples = {token for token, record in self._records("sample") if record.get("scene_token") == scene}
        found: dict[str, list[Taken]] = {}
        for _, record in self._records("sample_data"):
            if record.get("sample_token") not in samples:
                continue
            sensor = str(self._field("sample_data", record, "calibrated_sensor_token"))
            size = int(record.get("height") or 0), int(record.get("width") or 0)
            file, time_us = (
                self._field("sample_data", record, "filename"),
                self._field("sample_data", record, "timestamp"),
            )
            pose = str(self._field("sample_data", record, "ego_pose_token"))
            found.setdefault(self._channel(sensor), []).append(Taken(str(file), int(time_us), pose, sensor, size))
        return {channel: sorted(taken, key=lambda each: each.time_us) for channel, taken in found.items()}

    def T_world_ego(self, token: str) -> Matrix:
        """Return the vehicle's pose (4, 4) of an ego_pose."""
        return self._placed("ego_pose", self._get("ego_pose", token))

    def T_ego_sensor(self, token: str) -> Matrix:
        """Return a sensor's place on the vehicle (4, 4)."""
        return self._placed("calibrated_sensor", self._get("calibrated_sensor", token))

    def K(self, token: str) -> Matrix:
        """Return a camera's (3, 3), pixels."""
        record = self._get("calibrated_sensor", token)
        try:
            K = np.array(record.get("camera_intrinsic"), np.float64)
        except (TypeError, ValueError):
            K = np.zeros(0)
        if K.shape != (3, 3) or not np.isfinite(K).all() or min(K[0, 0], K[1, 1]) <= 0:
            raise DataError(
                f"{self._path('calibrated_sensor')}: {token}: camera_intrinsic is no pinhole camera: {MEND}"
            )
        return K

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}.json"

    @cached_property
    def _tables(self) -> dict[str, dict[str, Record]]:
        return {}

    def _table(self, name: str) -> dict[str, Record]:
        """Return a table's records by token."""
        if name not in self._tables:
            path = self._path(name)
            try:
                records = json.loads(read_text(path, MEND))
                self._tables[name] = {record["token"]: record for record in records}
            except (json.JSONDecodeError, RecursionError) as error:
                raise DataError(f"{path}: damaged JSON ({error}): {MEND}") from error
            except (KeyError, TypeError) as error:
                raise DataError(f"{path}: expected a list of records, each with a token: {MEND}") from error
        return self._tables[name]

    def _records(self, name: str) -> Iterator[tuple[str, Record]]:
        return iter(self._table(name).items())

    def _get(self, name: str, token: str) -> Record:
        record = self._table(name).get(token)
        if record is None:
            raise DataError(f"{self._path(name)}: no record {token}, which another table names: {MEND}")
        return record

    def _field(self, name: str, record: Record, key: str) -> Any:
        if record.get(key) is None:
            raise DataError(f"{self._path(name)}: record {record.get('token')} has no {key}: {MEND}")
        return record[key]

    def _channel(self, sensor: str) -> str:
        record = self._get("calibrated_sensor", sensor)
        of_sensor = self._get("sensor", str(self._field("calibrated_sensor", record, "sensor_token")))
        return str(self._field("sensor", of_sensor, "channel"))

    def _placed(self, name: str, record: Record) -> Matrix:
        where = f"{self._path(name)}: {record.get('token')}"
        return to_pose(record.get("rotation"), record.get("translation"), where)
