# ruff: noqa: E501 -- a case a line
"""What is mutated: small scenes and files that use every part of the readers, all made here."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from raytrace2.exr import write_exr

_VIEW = """<sensor type="perspective"><float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="0,0,5" target="0,0,0" up="0,1,0"/></transform>
    <film type="hdrfilm"><integer name="width" value="4"/><integer name="height" value="4"/>{filter}</film>
    <sampler type="independent"><integer name="sample_count" value="1"/></sampler></sensor>"""

VIEW = _VIEW.format(filter='<rfilter type="box"/>')

BASIC = f"""<scene version="3.0.0">
<integrator type="path"><integer name="max_depth" value="3"/><integer name="rr_depth" value="5"/></integrator>
{VIEW}
<bsdf type="diffuse" id="red"><rgb name="reflectance" value="0.8 0.1 0.1"/></bsdf>
<shape type="sphere"><point name="center" x="0.5" y="0" z="0"/><float name="radius" value="1"/><ref id="red"/></shape>
<shape type="disk"><transform name="to_world"><scale value="2"/><rotate x="1" angle="-80"/><translate y="-1"/></transform>
    <bsdf type="diffuse"><spectrum name="reflectance" value="400:0.1, 500:0.5, 700:0.9"/></bsdf></shape>
<emitter type="point"><point name="position" value="0 3 3"/><rgb name="intensity" value="10"/></emitter>
</scene>"""

MESHES = f"""<scene version="3.0.0">
<integrator type="direct"><integer name="shading_samples" value="1"/></integrator>
{VIEW}
<bsdf type="diffuse" id="picture"><texture type="bitmap" name="reflectance"><string name="filename" value="tex.png"/>
    <string name="wrap_mode" value="mirror"/><transform name="to_uv"><scale x="2" y="3"/></transform></texture></bsdf>
<shape type="ply"><string name="filename" value="mesh.ply"/><boolean name="flip_normals" value="false"/>
    <ref id="picture"/></shape>
<shape type="obj"><string name="filename" value="mesh.obj"/><boolean name="face_normals" value="true"/>
    <transform name="to_world"><translate x="1"/></transform></shape>
<shape type="serialized"><string name="filename" value="mesh.serialized"/><integer name="shape_index" value="0"/></shape>
<shape type="rectangle"><transform name="to_world"><scale x="0.5" y="0.5"/><translate z="4"/></transform>
    <emitter type="area"><rgb name="radiance" value="5 5 5"/></emitter></shape>
</scene>"""

MATERIALS = f"""<scene version="3.0.0">
<default name="depth" value="4"/>
<default name="raytrace2.accel" value="bvh"/>
<integrator type="path"><integer name="max_depth" value="$depth"/></integrator>
{VIEW}
<shape type="sphere"><float name="radius" value="0.5"/><bsdf type="dielectric"><float name="int_ior" value="1.5"/>
    <string name="ext_ior" value="air"/></bsdf></shape>
<shape type="cube"><transform name="to_world"><scale value="0.3"/><translate x="1"/></transform>
    <bsdf type="twosided"><bsdf type="conductor"><rgb name="eta" value="0.2 0.9 1.1"/><rgb name="k" value="3 2 2"/>
    </bsdf></bsdf></shape>
<shape type="cylinder"><point name="p0" value="-1 -1 0"/><point name="p1" value="-1 1 0"/>
    <float name="radius" value="0.2"/><bsdf type="mask"><float name="opacity" value="0.5"/><bsdf type="diffuse">
    <texture type="checkerboard" name="reflectance"><rgb name="color0" value="0.1"/></texture></bsdf></bsdf></shape>
<emitter type="constant"><rgb name="radiance" value="1 2 3"/></emitter>
</scene>"""

INSTANCES = """<scene version="3.0.0">
<integrator type="aov"><string name="aovs" value="z:depth,n:sh_normal"/></integrator>
<sensor type="thinlens"><float name="fov" value="50"/><string name="fov_axis" value="y"/>
    <float name="aperture_radius" value="0.1"/><float name="focus_distance" value="4"/>
    <float name="near_clip" value="0.1"/><float name="far_clip" value="100"/>
    <transform name="to_world"><matrix value="-1 0 0 0 0 1 0 0 0 0 -1 5 0 0 0 1"/></transform>
    <film type="hdrfilm"><integer name="width" value="6"/><integer name="height" value="6"/>
    <integer name="crop_offset_x" value="1"/><integer name="crop_offset_y" value="1"/>
    <integer name="crop_width" value="4"/><integer name="crop_height" value="4"/>
    <rfilter type="gaussian"><float name="stddev" value="0.5"/></rfilter></film>
    <sampler type="stratified"><integer name="sample_count" value="4"/><integer name="seed" value="3"/></sampler>
</sensor>
<shape type="shapegroup" id="group"><shape type="sphere"><float name="radius" value="0.4"/></shape></shape>
<shape type="instance"><ref id="group"/><transform name="to_world"><translate x="1"/></transform></shape>
<shape type="instance"><ref id="group"/><transform name="to_world"><rotate y="1" angle="45"/></transform></shape>
</scene>"""

LIGHTS = f"""<scene version="3.0.0">
<integrator type="direct"><integer name="emitter_samples" value="1"/><integer name="bsdf_samples" value="1"/></integrator>
{VIEW}
<include filename="part.xml"/>
<emitter type="spot"><transform name="to_world"><lookat origin="0,0,3" target="0,0,0" up="0,1,0"/></transform>
    <float name="cutoff_angle" value="30"/><float name="beam_width" value="20"/></emitter>
<emitter type="directional"><vector name="direction" x="0" y="-1" z="-1"/><rgb name="irradiance" value="1 1 1"/></emitter>
<emitter type="envmap"><string name="filename" value="env.exr"/><float name="scale" value="0.5"/></emitter>
</scene>"""

SCENES = {"basic": BASIC, "meshes": MESHES, "materials": MATERIALS, "instances": INSTANCES, "lights": LIGHTS}

PART = '<scene version="3.0.0"><shape type="rectangle" id="floor"><bsdf type="diffuse"/></shape></scene>'

VERTICES = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 0, 1]], dtype=np.float64)
FACES = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
UV = (VERTICES[:, :2] + 1) / 2


def ply(encoding: str, *, textured: bool = True) -> bytes:
    """The pyramid as PLY; ``encoding`` as its header calls it."""
    order = ">" if encoding == "binary_big_endian" else "<"
    header = f"ply\nformat {encoding} 1.0\ncomment a pyramid\nelement vertex {len(VERTICES)}\n"
    names = ["x", "y", "z", *(("u", "v") if textured else ())]
    header += "".join(f"property float {name}\n" for name in names)
    header += f"element face {len(FACES)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = np.concatenate([VERTICES, UV], axis=1) if textured else VERTICES
    if encoding == "ascii":
        lines = [" ".join(f"{x:g}" for x in row) for row in rows] + ["3 " + " ".join(map(str, f)) for f in FACES]
        return (header + "\n".join(lines) + "\n").encode()
    faces = b"".join(struct.pack(f"{order}B3i", 3, *map(int, f)) for f in FACES)
    return header.encode() + rows.astype(f"{order}f4").tobytes() + faces


def obj() -> bytes:
    """The pyramid as OBJ, with texture coordinates and normals."""
    lines = [
        "# a pyramid",
        *("v {:g} {:g} {:g}".format(*v) for v in VERTICES),
        *("vt {:g} {:g}".format(*t) for t in UV),
    ]
    lines += ["vn 0 0 1"] + ["f " + " ".join(f"{i + 1}/{i + 1}/1" for i in f) for f in FACES]
    return ("\n".join(lines) + "\n").encode()


def serialized(version: int = 4) -> bytes:
    """The pyramid twice in one serialized file."""
    word = "<Q" if version == 4 else "<I"
    data, offsets = b"", []
    for _ in range(2):
        offsets.append(len(data))
        content = struct.pack("<I", 0x1002) + (b"pyramid\0" if version == 4 else b"")
        content += struct.pack("<QQ", len(VERTICES), len(FACES))
        content += VERTICES.astype("<f4").tobytes() + UV.astype("<f4").tobytes() + FACES.astype("<u4").tobytes()
        data += struct.pack("<HH", 0x041C, version) + zlib.compress(content)
    return data + b"".join(struct.pack(word, o) for o in offsets) + struct.pack("<I", len(offsets))


def picture(mode: str = "RGB") -> Image.Image:
    pixels = np.random.default_rng(0).integers(0, 256, (12, 16, len(mode)), np.uint8)
    return Image.fromarray(pixels[:, :, 0] if mode == "L" else pixels, mode="L" if mode == "L" else None)


def encoded(form: str, mode: str = "RGB", **options: Any) -> bytes:
    """A small picture as ``form`` ("PNG", "JPEG", "BMP", "PPM", "TGA")."""
    stream = io.BytesIO()
    picture(mode).save(stream, form, **options)
    return stream.getvalue()


def png16() -> bytes:
    stream = io.BytesIO()
    Image.fromarray(np.random.default_rng(1).integers(0, 65536, (9, 7), np.uint16)).save(stream, "PNG")
    return stream.getvalue()


def exr(folder: Path, names: str = "RGB", kind: Any = np.float32) -> bytes:
    pixels = np.random.default_rng(2).random((6, 8, len(names))).astype(kind)
    write_exr(folder / "seed.exr", pixels, list(names))
    return (folder / "seed.exr").read_bytes()


def write_files(folder: Path) -> None:
    """The files that :data:`SCENES` name."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "part.xml").write_text(PART)
    (folder / "mesh.ply").write_bytes(ply("binary_little_endian"))
    (folder / "mesh.obj").write_bytes(obj())
    (folder / "mesh.serialized").write_bytes(serialized())
    (folder / "tex.png").write_bytes(encoded("PNG"))
    (folder / "env.exr").write_bytes(exr(folder))


def seeds_of(kind: str, folder: Path) -> list[bytes]:
    """The intact files that mutants of ``kind`` are made from."""
    if kind == "ply":
        encodings = ("ascii", "binary_little_endian", "binary_big_endian")
        return [ply(e, textured=t) for e in encodings for t in (True, False)]
    if kind == "obj":
        return [obj(), b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 4 3\n"]
    if kind == "serialized":
        return [serialized(4), serialized(3)]
    if kind == "png":
        return [encoded("PNG"), encoded("PNG", "L"), encoded("PNG", "RGBA"), png16()]
    if kind == "jpg":
        return [encoded("JPEG"), encoded("JPEG", "L"), encoded("JPEG", progressive=True)]
    if kind == "bmp":
        return [encoded("BMP"), encoded("PPM"), encoded("TGA"), encoded("TGA", compression="tga_rle")]
    return [exr(folder), exr(folder, "Y", np.float16), exr(folder, "RGBA", np.float16)]
