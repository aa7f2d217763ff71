from __future__ import annotations

import os
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from raytrace2.errors import FileError, Location
from raytrace2.scene.mesh_files import MeshData, finish_normals, load_mesh_file, vertex_normals

TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1.5, 0], [0.2, 0.3, 1.1]], dtype=np.float32)
TETRAHEDRON_FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], dtype=np.uint32)


@pytest.fixture(scope="module")
def mi():
    import raytrace2  # noqa: F401  (settles libLLVM)

    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("llvm_ad_rgb")
    before = mitsuba.log_level()
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    yield mitsuba
    mitsuba.set_log_level(before)


def require_same_as_mitsuba(mi, kind: str, path: Path, **options) -> MeshData:
    """Buffers bit for bit the same; normals, which Mitsuba computes in float32, to 1e-6 or so."""
    mesh = load_mesh_file(path, kind, **options)
    buffers = mi.traverse(mi.load_dict({"type": kind, "filename": str(path), **options}))
    np.testing.assert_array_equal(mesh.vertices.astype(np.float32), np.reshape(buffers["vertex_positions"], (-1, 3)))
    np.testing.assert_array_equal(mesh.faces, np.reshape(buffers["faces"], (-1, 3)))
    uv = np.reshape(buffers["vertex_texcoords"], (-1, 2))
    if mesh.uv is None:
        assert len(uv) == 0
    else:
        np.testing.assert_array_equal(mesh.uv.astype(np.float32), uv)
    normals = finish_normals(mesh.vertices, mesh.faces, mesh.normals, face_normals=options.get("face_normals", False))
    theirs = np.reshape(buffers["vertex_normals"], (-1, 3))
    if normals is None:
        assert len(theirs) == 0
    else:
        np.testing.assert_allclose(normals, theirs, atol=2e-6)
    standard = {"vertex_positions", "vertex_normals", "vertex_texcoords"}
    names = {k for k in buffers.keys() if k.startswith(("vertex_", "face_"))} - standard
    assert names == set(mesh.attributes)
    for name, values in mesh.attributes.items():
        np.testing.assert_allclose(values.ravel(), np.array(buffers[name]), rtol=1e-5, atol=1e-12)
    return mesh


# --- obj ------------------------------------------------------------------------------------------------------------

OBJ = """# a comment
mtllib none.mtl
o thing
v 0 0 0
v 1 0 0 0.5 0.5 0.5
  v\t1.25 1e0 -.5 # behind a vertex
v 0 1 0
v 0.1 0.7 1.3\r
vt 0.3 0.1
vt 0.7 0.9
vt 0.123456 0.654321
vn 0 0 2
vn 1 1 0.1

usemtl m
f 1/1/1 2/2/1 3/3/1 4/1/1
s off
f 3/3/1 2/2/1 5/3/2
f 3/3/2 2/2/1 05/3/2 1/1/1 4/2/2 # a fan
"""


@pytest.mark.parametrize(
    "text",
    [
        OBJ,
        OBJ.replace("\n", "\r\n"),
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 4 3 2\nf 4 2 1 3",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 .25\nvt 1 1\nf 1/1 3/2 2/2\n",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nvn 0 3 4\nf 3//2 1//1 2//1\n",
    ],
)
@pytest.mark.parametrize("options", [{}, {"flip_tex_coords": False}, {"face_normals": True}])
def test_obj_agrees_with_mitsuba(mi, tmp_path, text, options):
    path = tmp_path / "a.obj"
    path.write_text(text, newline="")
    require_same_as_mitsuba(mi, "obj", path, **options)


def test_random_obj_agrees_with_mitsuba(mi, tmp_path):
    rng = np.random.default_rng(3)
    lines = [f"v {x:.7g} {y:.9g} {z:.3g}" for x, y, z in rng.normal(size=(60, 3))]
    lines += [f"vt {x:.6f} {y:.6f}" for x, y in rng.random((40, 2))]
    lines += [f"vn {x:.6f} {y:.6f} {z:.6f}" for x, y, z in rng.normal(size=(20, 3))]
    for _ in range(300):
        n = rng.integers(3, 7)
        corners = zip(rng.integers(1, 61, n), rng.integers(1, 41, n), rng.integers(1, 21, n), strict=True)
        lines.append("f " + " ".join("/".join(map(str, c)) for c in corners))
    path = tmp_path / "random.obj"
    path.write_text("\n".join(lines))
    require_same_as_mitsuba(mi, "obj", path)


def test_obj_faces_without_normals_get_computed_ones(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvn 1 0 0\nf 1//1 2//1 3//1\nf 1 2 3\n")
    mesh = load_mesh_file(path, "obj")
    np.testing.assert_array_equal(mesh.normals, [[1, 0, 0]] * 3 + [[0, 0, 0]] * 3)
    normals = finish_normals(mesh.vertices, mesh.faces, mesh.normals)
    np.testing.assert_allclose(normals, [[1, 0, 0]] * 3 + [[0, 0, 1]] * 3, atol=1e-15)


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("v 0 0 0\nv 1 0\nv 0 1 0\nf 1 2 3\n", 2, "3 numbers expected"),
        ("v 0 0 0\nv 1 0 1_0\nv 0 1 0\nf 1 2 3\n", 2, "3 numbers expected"),
        ("v 0 0 0\nv 1 0 zero\nv 0 1 0\nf 1 2 3\n", 2, "3 numbers expected"),
        ("v 0 0 0\nv 1 0 0\n\nv 0 nan 0\nf 1 2 3\n", 4, "not finite"),
        ("v 0 0 0\nv 1 0 0\nv 0 1e999 0\nf 1 2 3\n", 3, "not finite"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", 4, "vertex 4"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", 4, "vertex 0"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -1 -2 -3\n", 4, "relative index"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/1 2/1 3/1\n", 4, "texture coordinate 1"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/99999999999\n", 5, "texture coordinate|refers"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//2 3//1\n", 5, "normal 2"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 0\nf 1//1 2//1 3//1\n", 5, "length zero"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2 3/1\n", 5, "only some corners"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2\n", 4, "2 corners"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 \\\n3\n", 4, "cannot read the corner"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", None, "empty"),
        ("", None, "empty"),
    ],
)
def test_bad_obj_names_the_line(tmp_path, text, line, words):
    path = tmp_path / "bad.obj"
    path.write_text(text)
    with pytest.raises(FileError, match=words) as caught:
        load_mesh_file(path, "obj")
    assert caught.value.problem.location is not None
    assert caught.value.problem.location.line == line
    assert str(path) in str(caught.value) and caught.value.problem.remedy
    assert "\n" not in str(caught.value)


# --- ply ------------------------------------------------------------------------------------------------------------


def ply(encoding: str, vertex: list[tuple[str, str]], face: list[tuple[str, str]], count: str, index: str) -> bytes:
    """A tetrahedron with the given vertex and face properties (name, PLY type), filled with reproducible values."""
    codes = {"float": "f4", "double": "f8", "uchar": "u1", "char": "i1", "ushort": "u2", "short": "i2", "int": "i4",
             "uint": "u4", "half": "f2"}  # fmt: skip
    rng = np.random.default_rng(11)
    order = ">" if encoding == "binary_big_endian" else "<"

    def value(name: str, kind: str, row: int):
        if name in "xyz":
            return float(TETRAHEDRON[row, "xyz".index(name)])
        if codes[kind][0] == "f":
            return float(np.dtype(codes[kind]).type(rng.random() + 0.25))
        limits = np.iinfo(codes[kind])
        return int(rng.integers(limits.min, limits.max, endpoint=True))

    header = f"ply\nformat {encoding} 1.0\ncomment made here\nelement vertex 4\n"
    header += "".join(f"property {kind} {name}\n" for name, kind in vertex)
    header += f"element face 4\nproperty list {count} {index} vertex_indices\n"
    header += "".join(f"property {kind} {name}\n" for name, kind in face) + "end_header\n"
    rows = [([value(n, k, i) for n, k in vertex], [codes[k] for _, k in vertex]) for i in range(4)]
    for i, corners in enumerate(TETRAHEDRON_FACES.tolist()):
        extra = [value(n, k, i) for n, k in face]
        rows.append(([3, *corners, *extra], [codes[count], *[codes[index]] * 3, *[codes[k] for _, k in face]]))
    if encoding == "ascii":
        return (header + "\n".join(" ".join(map(repr, values)) for values, _ in rows) + "\n").encode()
    pairs = [pair for values, kinds in rows for pair in zip(values, kinds, strict=True)]
    return header.encode() + b"".join(np.array(value, order + code).tobytes() for value, code in pairs)


XYZ = [("x", "float"), ("y", "float"), ("z", "float")]
NORMALS = [("nx", "float"), ("ny", "float"), ("nz", "float")]
PLY_LAYOUTS = {
    "plain": (XYZ, []),
    "doubles": ([(n, "double") for n in "xyz"], []),
    "normals_uv": (XYZ + NORMALS + [("u", "float"), ("v", "float")], []),
    "st": (XYZ + [("s", "half"), ("t", "half")], []),
    "texture_u": ([("texture_u", "float"), ("texture_v", "float"), *XYZ], []),
    "rgb": (XYZ + [("r", "float"), ("g", "float"), ("b", "float")], []),
    "red": (XYZ + [("red", "uchar"), ("green", "uchar"), ("blue", "uchar"), ("alpha", "uchar")], []),
    "integers": (XYZ + [("red", "short"), ("green", "short"), ("blue", "short")], []),
    "groups": (
        XYZ + [(f"heat_{c}", "float") for c in "0"] + [(f"tint_{c}", "ushort") for c in "rgb"]
        + [(f"flow_{c}", "float") for c in "xyz"] + [(f"one_{c}", "int") for c in "123"],
        [(f"paint_{c}", "float") for c in "rgb"] + [("id_0", "float")],
    ),
    "ignored": (XYZ + [("quality", "float")] + [(f"pair_{c}", "float") for c in "xy"] + [("q_z", "float")], []),
    "face_color": (XYZ, [("red", "uchar"), ("green", "uchar"), ("blue", "uchar")]),
}  # fmt: skip


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("layout", PLY_LAYOUTS)
def test_ply_agrees_with_mitsuba(mi, tmp_path, encoding, layout):
    path = tmp_path / "a.ply"
    path.write_bytes(ply(encoding, *PLY_LAYOUTS[layout], "uchar", "int"))
    mesh = require_same_as_mitsuba(mi, "ply", path)
    np.testing.assert_array_equal(mesh.faces, TETRAHEDRON_FACES)
    require_same_as_mitsuba(mi, "ply", path, face_normals=True, flip_tex_coords=True)


@pytest.mark.parametrize(("count", "index"), [("int", "uint"), ("uchar", "short"), ("ushort", "uchar")])
def test_ply_index_types(mi, tmp_path, count, index):
    path = tmp_path / "a.ply"
    path.write_bytes(ply("binary_little_endian", XYZ, [], count, index))
    require_same_as_mitsuba(mi, "ply", path)


def test_ply_skips_other_elements(mi, tmp_path):
    text = ply("ascii", XYZ, [], "uchar", "int").decode()
    text = text.replace("element face", "element thing 2\nproperty int a\nelement face")
    text = text.replace("\n3 0", "\n5\n6\n3 0", 1)
    path = tmp_path / "a.ply"
    path.write_text(text)
    require_same_as_mitsuba(mi, "ply", path)


PLY_ASCII = ply("ascii", XYZ, [], "uchar", "int").decode()
FIRST_FACE = "3 0 2 1\n"


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("plyx" + PLY_ASCII[3:], 1, "cannot read the header line"),
        (PLY_ASCII.replace("float x", "floot x"), 5, "cannot read the header line"),
        (PLY_ASCII.replace("vertex 4", "vertex -4"), 4, "cannot read the header line"),
        (PLY_ASCII.replace("vertex 4", "vertex 99999999999999"), 4, "the file ends"),
        (PLY_ASCII.replace("face 4", "face 5"), 8, "the file ends"),
        (PLY_ASCII.replace("end_header", "end"), 10, "cannot read the header line"),
        (PLY_ASCII.replace("vertex_indices", "corners"), 8, "faces need one list"),
        (PLY_ASCII.replace(FIRST_FACE, "4 0 2 1 3\n"), 15, "only lists of three"),
        (PLY_ASCII.replace(FIRST_FACE, "3 0 2 4\n"), 15, "vertex 4"),
        (PLY_ASCII.replace(FIRST_FACE, "3 0 2 -1\n"), 15, "vertex -1"),
        (PLY_ASCII.replace(FIRST_FACE, "3 0 2 1.5\n"), 15, "cannot read '1.5'"),
        (PLY_ASCII.replace("\n1.0", "\nnan"), 12, "not finite"),
        (PLY_ASCII.replace("\n1.0", "\n1.0.0"), 12, "cannot read '1.0.0'"),
        (PLY_ASCII + "1 2 3\n", None, "follow the last record"),
        (PLY_ASCII.replace("element vertex", "element point"), 10, "no element 'vertex'"),
    ],
)
def test_bad_ply_names_the_line(tmp_path, text, line, words):
    path = tmp_path / "bad.ply"
    path.write_text(text)
    with pytest.raises(FileError, match=words) as caught:
        load_mesh_file(path, "ply")
    assert caught.value.problem.location is not None
    assert caught.value.problem.location.line == line
    assert caught.value.problem.remedy and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("vertex", "words"), [([XYZ[0], ("y", "int"), XYZ[2]], "'y' .* integer"), (XYZ[:2], "lack x, y or z")]
)
def test_ply_positions_that_are_none(tmp_path, vertex, words):
    path = tmp_path / "bad.ply"
    path.write_bytes(ply("binary_little_endian", vertex, [], "uchar", "int"))
    with pytest.raises(FileError, match=words) as caught:
        load_mesh_file(path, "ply")
    assert caught.value.problem.location == Location(str(path), 4)


@pytest.mark.parametrize("count", [0, 5, 10**17])
def test_ply_counts_are_held_against_the_file(tmp_path, count):
    data = ply("binary_little_endian", XYZ, [], "uchar", "int")
    path = tmp_path / "bad.ply"
    for element in (b"vertex", b"face"):
        path.write_bytes(data.replace(b"element %s 4" % element, b"element %s %d" % (element, count)))
        with pytest.raises(FileError):
            load_mesh_file(path, "ply")
    path.write_bytes(data[:-1])
    with pytest.raises(FileError, match="announced"):
        load_mesh_file(path, "ply")


# --- serialized -----------------------------------------------------------------------------------------------------


def serialized_mesh(version: int, flags: int, scale: float = 1.0, **changes) -> bytes:
    """A stream of the tetrahedron; ``changes`` may give other counts and indices."""
    real = "<f8" if flags & 0x2000 else "<f4"
    rng = np.random.default_rng(5)
    body = struct.pack("<I", flags) + (b"name\0" if version == 4 else b"")
    body += struct.pack("<QQ", changes.get("vertices", 4), changes.get("faces", 4))
    with np.errstate(over="ignore"):
        body += (TETRAHEDRON.astype(np.float64) * scale + 0.1).astype(real).tobytes()
    for flag, columns in ((1, 3), (2, 2), (8, 3)):
        if flags & flag:
            body += (rng.random((4, columns)) + 0.1).astype(real).tobytes()
    body += changes.get("indices", TETRAHEDRON_FACES).astype("<u4").tobytes()
    return struct.pack("<HH", 0x041C, version) + zlib.compress(body)


def serialized_file(version: int, meshes: list[bytes]) -> bytes:
    offsets = [sum(map(len, meshes[:i])) for i in range(len(meshes))]
    word = "Q" if version == 4 else "I"
    return b"".join(meshes) + struct.pack(f"<{len(meshes)}{word}I", *offsets, len(meshes))


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("flags", [0x1000, 0x1001, 0x1002, 0x100B, 0x1011, 0x2000, 0x200B])
def test_serialized_agrees_with_mitsuba(mi, tmp_path, version, flags):
    path = tmp_path / "a.serialized"
    path.write_bytes(serialized_file(version, [serialized_mesh(version, flags, s) for s in (1, 2, 3)]))
    for index in range(3):
        mesh = require_same_as_mitsuba(mi, "serialized", path, shape_index=index)
        assert mesh.vertices.dtype == (np.float64 if flags & 0x2000 else np.float32)
        require_same_as_mitsuba(mi, "serialized", path, shape_index=index, face_normals=True)


def test_bad_serialized(tmp_path):
    path = tmp_path / "bad.serialized"
    good = serialized_file(4, [serialized_mesh(4, 0x1000)] * 2)

    def refused(data: bytes, words: str, index: int = 0) -> None:
        path.write_bytes(data)
        with pytest.raises(FileError, match=words) as caught:
            load_mesh_file(path, "serialized", shape_index=index)
        assert caught.value.problem.remedy and "\n" not in str(caught.value)

    refused(b"", "only 0 bytes")
    refused(b"ply\n" + good[4:], "not a serialized mesh")
    refused(good[:2] + b"\5\0" + good[4:], "version 5")
    refused(good, "no shape 2", 2)
    refused(good, "no shape -1", -1)
    refused(good[:-4] + b"\xff" * 4, "more than fit", 1)
    refused(good[:40], "too early")
    refused(good[:30] + bytes([good[30] ^ 255]) + good[31:], "damaged|too early|speaks|index|finite|refers")
    refused(serialized_mesh(4, 0x1000, vertices=10**15), "speaks of")
    refused(serialized_mesh(4, 0x1000, faces=2**64 - 1), "speaks of")
    refused(serialized_mesh(4, 0x1000, vertices=0, faces=0), "empty")
    refused(serialized_mesh(4, 0x1000, indices=TETRAHEDRON_FACES + 1), "refers to vertex 4")
    refused(serialized_mesh(4, 0x1000, scale=1e300), "not finite")
    bomb = struct.pack("<IQQ", 0x1000, 40_000_000, 0) + bytes(1 << 20)
    refused(struct.pack("<HH", 0x041C, 3) + zlib.compress(bomb, 9), "speaks of")


# --- all formats ----------------------------------------------------------------------------------------------------

SEEDS = [("obj", OBJ.encode())]
SEEDS += [
    ("ply", ply(e, *PLY_LAYOUTS[name], "uchar", "int"))
    for e in ("ascii", "binary_little_endian", "binary_big_endian")
    for name in ("normals_uv", "groups")
]
SEEDS += [("serialized", serialized_file(v, [serialized_mesh(v, f)] * 2)) for v in (3, 4) for f in (0x100B, 0x2001)]


@settings(max_examples=600, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_files_give_a_mesh_or_a_file_error(tmp_path, data):
    kind, content = data.draw(st.sampled_from(SEEDS))
    changed = bytearray(content)
    for _ in range(data.draw(st.integers(0, 4))):
        changed[data.draw(st.integers(0, len(changed) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(changed))) if data.draw(st.booleans()) else len(changed)
    extra = data.draw(st.binary(max_size=6))
    path = tmp_path / "damaged"
    path.write_bytes(bytes(changed[:cut]) + extra)
    try:
        mesh = load_mesh_file(path, kind, shape_index=data.draw(st.integers(0, 2)) if kind == "serialized" else 0)
    except FileError as error:
        assert "\n" not in str(error)
        return
    assert mesh.faces.dtype == np.uint32 and mesh.faces.max() < len(mesh.vertices)
    for array in (mesh.vertices, mesh.normals, mesh.uv, *mesh.attributes.values()):
        assert array is None or np.isfinite(array).all()
    normals = finish_normals(mesh.vertices, mesh.faces, mesh.normals)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=1e-12)


def test_paths_that_are_no_files(tmp_path):
    for path in (tmp_path, tmp_path / "missing.ply", Path("/dev/zero"), Path("nul\0byte")):
        with pytest.raises(FileError) as caught:
            load_mesh_file(path, "ply")
        assert caught.value.problem.remedy
    with pytest.raises(ValueError, match="kind"):
        load_mesh_file(tmp_path / "x.stl", "stl")  # type: ignore[arg-type]


@pytest.mark.parametrize("scale", [1e-300, 1e-160, 1e-20, 1.0, 1e20, 1e150, 1e308])
def test_computed_normals_do_not_depend_on_scale(scale):
    expected = vertex_normals(TETRAHEDRON, TETRAHEDRON_FACES)
    scaled = vertex_normals(TETRAHEDRON.astype(np.float64) * scale, TETRAHEDRON_FACES)
    np.testing.assert_allclose(scaled, expected, rtol=0, atol=1e-6 if scale < 1e-299 else 1e-14)


def test_vertices_without_area_get_a_normal():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [5, 5, 5]])
    np.testing.assert_array_equal(vertex_normals(vertices, np.array([[0, 1, 2], [0, 0, 1]])), [[1, 0, 0]] * 4)


@pytest.mark.skipif("RAYTRACE2_MITSUBA_DATA" not in os.environ, reason="RAYTRACE2_MITSUBA_DATA names no folder")
def test_meshes_of_the_mitsuba_gallery(mi):
    folder = Path(os.environ["RAYTRACE2_MITSUBA_DATA"]) / "common" / "meshes"
    for path in sorted(folder.rglob("*.*")):
        kind = path.suffix[1:]
        if kind == "serialized":
            (count,) = struct.unpack("<I", path.read_bytes()[-4:])
            for index in range(count):
                require_same_as_mitsuba(mi, kind, path, shape_index=index)
        elif kind in ("obj", "ply"):
            require_same_as_mitsuba(mi, kind, path)
            require_same_as_mitsuba(mi, kind, path, face_normals=True)
