"""Coloured triangle meshes as PLY, OBJ and GLB files.

| file | positions, normals | colours                                   | who reads it                       |
|------|--------------------|-------------------------------------------|------------------------------------|
| .ply | float32            | 8 bits, sRGB                              | MeshLab, CloudCompare, Open3D      |
| .obj | text               | 0..1, sRGB, behind a vertex's coordinates | MeshLab, Blender                   |
| .glb | float32            | 16 bits, linear, as glTF 2.0 asks         | Blender, three.js, Windows, macOS  |

Far from the world's zero float32 is too coarse. Vertices are therefore float32 near an origin, and the files hold the
drive's own coordinates all the same: a .ply as doubles, an .obj as text of more digits, a .glb as the translation of
its node.

They are written here and not by open3d: its writers (0.20) tell of no full disk, and its GLB puts the data into a text
that many programs refuse.
"""

import io
import json
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from eval.files import write_bytes
from priors.errors import DataError
from priors.types import FloatMap

COMMENT = "metres, in the drive's world frame"


@dataclass(frozen=True, slots=True)
class Triangles:
    """A mesh of n vertices and m triangles."""

    vertices_m: FloatMap
    """(n, 3) float32 metres from the origin."""
    normals: FloatMap
    """(n, 3) float32, unit."""
    colours: npt.NDArray[np.uint8]
    """(n, 3) RGB, sRGB as in images."""
    faces: npt.NDArray[np.integer]
    """(m, 3) vertices of each triangle, anticlockwise as seen from outside."""
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where the vertices' frame begins in the drive's world frame, metres."""

    @property
    def moved(self) -> bool:
        """Whether the vertices' frame is not the drive's."""
        return any(self.origin_m)

    def places_m(self) -> npt.NDArray[np.floating]:
        """Return the vertices (n, 3) in the drive's world frame: float64 where it is moved, else as they are."""
        return self.vertices_m.astype(np.float64) + self.origin_m if self.moved else self.vertices_m


def check_name(path: Path) -> None:
    """Refuse a mesh's file before any work; DataError where its name ends in none of WRITERS."""
    if path.suffix.lower() not in WRITERS:
        raise DataError(f"{path}: expected a name that ends in {' or '.join(WRITERS)}")


def write_triangles(path: Path, mesh: Triangles) -> None:
    """Write a mesh in the format that the name's ending says, atomically."""
    check_name(path)
    write_bytes(path, WRITERS[path.suffix.lower()](mesh))


def ply(mesh: Triangles) -> bytes:
    """Return a binary little-endian PLY file."""
    place, wide = ("double", "<f8") if mesh.moved else ("float", "<f4")
    kinds = dict.fromkeys(("x", "y", "z"), place) | dict.fromkeys(("nx", "ny", "nz"), "float")
    kinds |= dict.fromkeys(("red", "green", "blue"), "uchar")
    head = ["ply", "format binary_little_endian 1.0", f"comment {COMMENT}", f"element vertex {len(mesh.vertices_m)}"]
    head += [f"property {kind} {name}" for name, kind in kinds.items()]
    head += [f"element face {len(mesh.faces)}", "property list uchar uint vertex_indices", "end_header"]
    vertices = np.zeros(len(mesh.vertices_m), [("place", wide, 3), ("normal", "<f4", 3), ("colour", "u1", 3)])
    vertices["place"], vertices["normal"], vertices["colour"] = mesh.places_m(), mesh.normals, mesh.colours
    faces = np.zeros(len(mesh.faces), [("count", "u1"), ("corners", "<u4", 3)])
    faces["count"], faces["corners"] = 3, mesh.faces
    return "".join(f"{line}\n" for line in head).encode() + vertices.tobytes() + faces.tobytes()


def obj(mesh: Triangles) -> bytes:
    """Return an OBJ file; colours follow the coordinates, as MeshLab writes them."""
    text = io.StringIO()
    text.write(f"# {COMMENT}\n")
    vertices = np.concatenate([mesh.places_m(), mesh.colours / np.float32(255)], axis=1)
    place = "%.4f %.4f %.4f" if mesh.moved else "%.6g %.6g %.6g"
    np.savetxt(text, vertices, f"v {place} %.4g %.4g %.4g")
    np.savetxt(text, mesh.normals, "vn %.4g %.4g %.4g")
    np.savetxt(text, np.repeat(mesh.faces + 1, 2, axis=1), "f %d//%d %d//%d %d//%d")
    return text.getvalue().encode()


def glb(mesh: Triangles) -> bytes:
    """Return a binary glTF 2.0 file: a JSON chunk that describes a chunk of data."""
    colours = np.full((len(mesh.colours), 4), 65535, "<u2")
    colours[:, :3] = np.rint(65535 * linear(mesh.colours / 255))
    parts: list[tuple[npt.NDArray[Any], dict[str, Any]]] = [
        (mesh.vertices_m.astype("<f4"), {"componentType": 5126, "type": "VEC3", **_ends(mesh.vertices_m)}),
        (mesh.normals.astype("<f4"), {"componentType": 5126, "type": "VEC3"}),
        (colours, {"componentType": 5123, "type": "VEC4", "normalized": True}),
        (mesh.faces.astype("<u4").ravel(), {"componentType": 5125, "type": "SCALAR"}),
    ]
    data, views, accessors = b"", [], []
    for i, (values, kind) in enumerate(parts):  # every part's size is a multiple of 4 bytes, as glTF asks
        target = 34963 if values.ndim == 1 else 34962  # indices, or what belongs to vertices
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": values.nbytes, "target": target})
        accessors.append({"bufferView": i, "count": len(values), **kind})
        data += values.tobytes()
    attributes = {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2}
    content = {
        "asset": {"version": "2.0", "generator": "roadprior", "extras": {"comment": COMMENT}},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, **({"translation": list(mesh.origin_m)} if mesh.moved else {})}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 3, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1}, "doubleSided": True}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(data)}],
    }
    text = json.dumps(content, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    size = 12 + 8 + len(text) + 8 + len(data)
    head = struct.pack("<4sII", b"glTF", 2, size)
    return head + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data


def linear(srgb: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
    """Turn sRGB values in [0, 1] into linear ones (IEC 61966-2-1)."""
    values = np.asarray(srgb, dtype=np.float64)
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def _ends(values: FloatMap) -> dict[str, list[float]]:
    """Return the least and the largest place, which glTF asks for."""
    return {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}


WRITERS: dict[str, Callable[[Triangles], bytes]] = {".ply": ply, ".obj": obj, ".glb": glb}
