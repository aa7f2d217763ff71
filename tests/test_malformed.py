"""Ten kinds of malformed scene on the command line: one line with the file and the line, exit status 2."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from raytrace2 import cli

SCENE = """<scene version="3.0.0">
    <integrator type="path"/>
    <sensor type="perspective">
        <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film>
    </sensor>
    {body}
</scene>
"""


def ply(path: Path, vertices: np.ndarray, faces: np.ndarray) -> bytes:
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    body = vertices.astype("<f4").tobytes() + b"".join(struct.pack("<B3i", 3, *map(int, f)) for f in faces)
    path.write_bytes(header.encode() + body)
    return path.read_bytes()


TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=float)
MESH = '<shape type="ply"><string name="filename" value="mesh.ply"/></shape>'


def unknown_plugin(folder: Path) -> str:
    return '<shape type="dodecahedron"/>'


def missing_file(folder: Path) -> str:
    return '<shape type="obj"><string name="filename" value="nowhere.obj"/></shape>'


def broken_xml(folder: Path) -> str:
    return '<shape type="sphere">'


def bad_number(folder: Path) -> str:
    return '<shape type="sphere"><float name="radius" value="one"/></shape>'


def cyclic_ref(folder: Path) -> str:
    return (
        '<bsdf type="twosided" id="a"><ref id="b"/></bsdf><bsdf type="twosided" id="b"><ref id="a"/></bsdf>'
        '<shape type="sphere"><ref id="a"/></shape>'
    )


def face_index_out_of_range(folder: Path) -> str:
    ply(folder / "mesh.ply", TRIANGLE, np.array([[0, 1, 7]]))
    return MESH


def nan_vertex(folder: Path) -> str:
    ply(folder / "mesh.ply", TRIANGLE * [1, np.nan, 1], np.array([[0, 1, 2]]))
    return MESH


def truncated_ply(folder: Path) -> str:
    data = ply(folder / "mesh.ply", TRIANGLE, np.array([[0, 1, 2]]))
    (folder / "mesh.ply").write_bytes(data[:-10])
    return MESH


def truncated_png(folder: Path) -> str:
    stream = io.BytesIO()
    Image.fromarray(np.random.default_rng(0).integers(0, 256, (32, 32, 3), np.uint8)).save(stream, "PNG")
    (folder / "texture.png").write_bytes(stream.getvalue()[:-500])
    return (
        '<shape type="sphere"><bsdf type="diffuse"><texture name="reflectance" type="bitmap">'
        '<string name="filename" value="texture.png"/></texture></bsdf></shape>'
    )


def empty_mesh(folder: Path) -> str:
    ply(folder / "mesh.ply", np.zeros((0, 3)), np.zeros((0, 3)))
    return MESH


KINDS = [
    unknown_plugin, missing_file, broken_xml, bad_number, cyclic_ref, face_index_out_of_range, nan_vertex,
    truncated_ply, truncated_png, empty_mesh,
]  # fmt: skip


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.__name__)
def test_one_line_and_status_2(kind, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "scene.xml"
    scene.write_text(SCENE.format(body=kind(tmp_path)))
    assert cli.main(["render", str(scene), "-o", str(tmp_path / "out.exr")]) == 2
    out, err = capfd.readouterr()
    lines = err.strip().splitlines()
    assert out == "" and len(lines) == 1, err
    assert lines[0].startswith("raytrace2: ") and "Traceback" not in err
    assert f"{tmp_path}" in lines[0] and any(f".{ending}" in lines[0] for ending in ("xml:", "ply", "png", "obj"))
    assert "scene.xml:" in lines[0], "the line of the scene file"
    assert not (tmp_path / "out.exr").exists()


def test_no_scene_file(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["render", str(tmp_path / "none.xml")]) == 2
    assert len(capfd.readouterr().err.strip().splitlines()) == 1


def test_all_problems_at_once(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "scene.xml"
    scene.write_text(
        SCENE.format(body=unknown_plugin(tmp_path) + "\n" + missing_file(tmp_path) + '\n<bsdf type="x" id="a"/>')
    )
    assert cli.main(["render", str(scene)]) == 2
    assert "nowhere.obj" in capfd.readouterr().err
