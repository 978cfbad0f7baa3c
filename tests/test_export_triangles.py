"""Meshes: each format read back by its own rules, as a stranger would."""

import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import FullDisk
from hypothesis import given, settings
from hypothesis import strategies as st

from priors.errors import DataError
from priors.export.triangles import Triangles, glb, linear, obj, ply, write_triangles


def mesh(vertices: int = 40, faces: int = 60, seed: int = 0) -> Triangles:
    random = np.random.default_rng(seed)
    normals = random.standard_normal((vertices, 3)).astype(np.float32)
    return Triangles(
        random.uniform(-90, 90, (vertices, 3)).astype(np.float32),
        normals / np.linalg.norm(normals, axis=1, keepdims=True),
        random.integers(0, 256, (vertices, 3), dtype=np.uint8),
        random.integers(0, vertices, (faces, 3)),
    )


def read_ply(data: bytes) -> Triangles:
    head, body = data.split(b"end_header\n", 1)
    lines = [line.split() for line in head.decode().splitlines()]
    assert lines[:2] == [["ply"], ["format", "binary_little_endian", "1.0"]]
    counts = {line[1]: int(line[2]) for line in lines if line[0] == "element"}
    assert list(counts) == ["vertex", "face"]
    kinds = {"float": "<f4", "double": "<f8", "uchar": "u1"}
    fields = np.dtype([(line[2], kinds[line[1]]) for line in lines if line[0] == "property" and line[1] != "list"])
    assert ["property", "list", "uchar", "uint", "vertex_indices"] in lines
    table = np.frombuffer(body, fields, counts["vertex"])
    faces = np.frombuffer(body, np.dtype([("n", "u1"), ("i", "<u4", 3)]), counts["face"], table.nbytes)
    assert (faces["n"] == 3).all()
    assert table.nbytes + faces.nbytes == len(body)
    columns = [np.stack([table[name] for name in names], axis=1) for names in
               (("x", "y", "z"), ("nx", "ny", "nz"), ("red", "green", "blue"))]  # fmt: skip
    return Triangles(*columns, faces["i"])


def read_glb(data: bytes) -> tuple[dict, list[np.ndarray]]:
    """Return the description, and what each accessor holds."""
    magic, version, size = struct.unpack("<4sII", data[:12])
    assert (magic, version, size) == (b"glTF", 2, len(data))
    length, kind = struct.unpack("<I4s", data[12:20])
    assert kind == b"JSON" and length % 4 == 0
    content = json.loads(data[20 : 20 + length])
    rest = data[20 + length :]
    length, kind = struct.unpack("<I4s", rest[:8])
    assert kind == b"BIN\0" and length == len(rest) - 8 == content["buffers"][0]["byteLength"]
    held = []
    for accessor in content["accessors"]:
        view = content["bufferViews"][accessor["bufferView"]]
        assert view["byteOffset"] % 4 == 0
        part = rest[8 + view["byteOffset"] :][: view["byteLength"]]
        columns = {"VEC3": 3, "VEC4": 4, "SCALAR": 1}[accessor["type"]]
        values = np.frombuffer(part, {5126: "<f4", 5123: "<u2", 5125: "<u4"}[accessor["componentType"]])
        held.append(values.reshape(-1, columns))
        assert len(held[-1]) == accessor["count"]
    return content, held


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 50), st.integers(1, 70), st.integers(0, 99))
def test_a_ply_holds_the_mesh(vertices: int, faces: int, seed: int) -> None:
    made = mesh(vertices, faces, seed)
    found = read_ply(ply(made))
    for ours, theirs in zip((made.vertices_m, made.normals, made.colours, made.faces),
                            (found.vertices_m, found.normals, found.colours, found.faces), strict=True):  # fmt: skip
        assert np.array_equal(ours, theirs)


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 50), st.integers(1, 70), st.integers(0, 99))
def test_a_glb_holds_the_mesh_with_linear_colours(vertices: int, faces: int, seed: int) -> None:
    made = mesh(vertices, faces, seed)
    content, (places, normals, colours, corners) = read_glb(glb(made))
    primitive = content["meshes"][0]["primitives"][0]
    assert primitive["attributes"] == {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2} and primitive["indices"] == 3
    assert np.array_equal(places, made.vertices_m)
    assert np.array_equal(normals, made.normals)
    assert np.array_equal(corners.reshape(-1, 3), made.faces)
    assert content["accessors"][0]["min"] == made.vertices_m.min(axis=0).tolist()
    assert (colours[:, 3] == 65535).all()
    assert np.abs(colours[:, :3] / 65535 - linear(made.colours / 255)).max() < 1e-5


def test_an_obj_holds_the_mesh() -> None:
    made = mesh()
    lines = [line.split() for line in obj(made).decode().splitlines() if not line.startswith("#")]
    vertices = np.array([line[1:] for line in lines if line[0] == "v"], float)
    assert np.allclose(vertices[:, :3], made.vertices_m, rtol=1e-5)
    assert np.array_equal(np.rint(255 * vertices[:, 3:]), made.colours)
    assert np.allclose(np.array([line[1:] for line in lines if line[0] == "vn"], float), made.normals, atol=1e-4)
    corners = [[tuple(map(int, corner.split("//"))) for corner in line[1:]] for line in lines if line[0] == "f"]
    assert [[vertex - 1 for vertex, _ in face] for face in corners] == made.faces.tolist()
    assert all(vertex == normal for face in corners for vertex, normal in face)


def test_far_from_zero_every_format_holds_exact_places() -> None:
    """float32 would step by 0.5 m there."""
    far = replace(mesh(), origin_m=(455000.0, 5428001.0, 111.0))
    expected_m = far.vertices_m.astype(np.float64) + far.origin_m
    assert np.array_equal(read_ply(ply(far)).vertices_m, expected_m)
    lines = [line.split() for line in obj(far).decode().splitlines() if line.startswith("v ")]
    assert np.abs(np.array([line[1:4] for line in lines], float) - expected_m).max() < 1e-4
    content, (places, *_) = read_glb(glb(far))
    assert np.abs(places.astype(np.float64) + content["nodes"][0]["translation"] - expected_m).max() < 1e-9


def test_linear_light() -> None:
    assert linear(np.array([0, 0.04045, 0.5, 1])) == pytest.approx([0, 0.0031308, 0.2140411, 1], abs=1e-6)


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".glb"])
def test_a_full_disk_leaves_the_old_file_and_names_it(tmp_path: Path, full_disk: FullDisk, suffix: str) -> None:
    path = tmp_path / "new" / f"a{suffix}"
    write_triangles(path, mesh(3, 1))
    old = path.read_bytes()
    with full_disk(2000), pytest.raises(OSError) as told:
        write_triangles(path, mesh(900, 900))
    assert told.value.filename == str(path)
    assert path.read_bytes() == old
    assert len(list(path.parent.iterdir())) == 1
    with pytest.raises(DataError, match=r"a.stl: expected a name that ends in .ply or .obj or .glb"):
        write_triangles(path.with_suffix(".stl"), mesh())
