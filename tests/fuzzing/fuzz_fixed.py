# ruff: noqa: E501 -- a case a line
"""Hostile input by name: attacks that are known, values that must be refused, and a case for every bug that was found."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fuzz_judge
import fuzz_seeds
import numpy as np
from fuzz_judge import Nonsense
from fuzz_seeds import BASIC, VIEW

import raytrace2 as rt


def run(name: str, folder: Path) -> tuple[str, str]:
    """What becomes of the attack ``name``, which must be refused with the words that go with it."""
    make, words = ATTACKS[name]

    def call() -> None:
        fuzz_seeds.write_files(folder)
        try:
            make(folder)
        except (rt.RayTraceError, TypeError, ValueError) as error:
            if words not in str(error):
                raise Nonsense(f"the message does not say {words!r}: {error}") from None
            raise
        raise Nonsense("accepted")

    return fuzz_judge.judge(call)


def _scene(body: str) -> str:
    return f'<scene version="3.0.0"><integrator type="direct"/>{VIEW}{body}</scene>'


def _file(text: str | bytes) -> Callable[[Path], Any]:
    """Loads and renders a scene file."""

    def make(folder: Path) -> None:
        path = folder / "attack.xml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        fuzz_judge.render_small(rt.load_file(path))

    return make


def _included(*texts: str) -> Callable[[Path], Any]:
    """Loads 0.xml, beside which the others lie as 1.xml and so on."""

    def make(folder: Path) -> None:
        for number, text in enumerate(texts):
            (folder / f"{number}.xml").write_text(text)
        rt.load_file(folder / "0.xml")

    return make


def _dict(**entries: Any) -> Callable[[Path], Any]:
    return lambda folder: fuzz_judge.render_small(rt.load_dict({"type": "scene", **entries}))


def _mesh(kind: str, data: bytes) -> Callable[[Path], Any]:
    def make(folder: Path) -> None:
        (folder / f"attack.{kind}").write_bytes(data)
        rt.load_dict({"type": "scene", "s": {"type": kind, "filename": str(folder / f"attack.{kind}")}})

    return make


def _image(name: str, data: bytes) -> Callable[[Path], Any]:
    def make(folder: Path) -> None:
        (folder / name).write_bytes(data)
        _file(_scene(f'<emitter type="envmap"><string name="filename" value="{name}"/></emitter>'))(folder)

    return make


def _render(**settings: Any) -> Callable[[Path], Any]:
    return lambda folder: rt.render(rt.load_string(BASIC), **settings)


_DEEP = '<bsdf type="twosided">' * 30_000 + "</bsdf>" * 30_000
_COPIES = "".join(f'<default name="a{i + 1}" value="{f"$a{i}" * 10}"/>' for i in range(12))
_SHAPE = '<shape type="sphere">{}</shape>'


def _property(tag: str, name: str, value: str) -> str:
    return f'<{tag} name="{name}" value="{value}"/>'


def _diffuse(tag: str, value: str) -> str:
    return _SHAPE.format(f'<bsdf type="diffuse">{_property(tag, "reflectance", value)}</bsdf>')


def _sensor(inside: str) -> str:
    return f'<scene version="3.0.0"><sensor type="perspective">{inside}</sensor></scene>'


def _film(name: str, value: str) -> str:
    return _sensor(f'<film type="hdrfilm">{_property("integer", name, value)}</film>')


def _png(width: int, height: int) -> bytes:
    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(bytes(100))) + chunk(b"IEND", b"")
    )


def _hit(**fields: Any) -> Callable[[Path], Any]:
    def make(folder: Path) -> None:
        structure = rt.accel.build(rt.TriangleMesh(fuzz_seeds.VERTICES, fuzz_seeds.FACES))
        ray = rt.Ray(np.zeros((8, 3)), [0, 0, -1])
        hit = structure.intersect(ray)
        for name, value in fields.items():
            setattr(hit, name, type(getattr(hit, name))(value))
        structure.interact(ray, hit)

    return make


_PLY = "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nelement face {}\n"
_PLY += "property list uchar int vertex_index\nend_header\n"

#: Name: (what is done in a folder, words that the refusal has to say).
ATTACKS: dict[str, tuple[Callable[[Path], Any], str]] = {
    # Text that starves or kills a parser.
    "deep nesting": (_file(_scene(_DEEP)), "nested more than 100 deep"),
    "deep nesting in UTF-16": (_file(_scene(_DEEP).encode("utf-16")), "null character"),
    "deep nesting in an included file": (_included(_scene('<include filename="1.xml"/>'), _scene(_DEEP)), "1.xml:"),
    "deep nesting behind a doctype": (_file("<!DOCTYPE a [" + "</x>" * 60_000 + "]>" + _scene(_DEEP)), "deep"),
    "deep nesting behind a quoted comment": (_file(_scene('<shape type="<!--"/>' + _DEEP + '<shape type="-->"/>')), "deep"),
    "deep nesting of tags that begin with é": (_file(_scene("<é>" * 30_000 + "</é>" * 30_000)), "deep"),
    "billion laughs by entities": (_file('<!DOCTYPE s [<!ENTITY a "ha"><!ENTITY b "&a;&a;">]>' + _scene(_diffuse("rgb", "&b;"))), "&b;"),
    "billion laughs by defaults": (_file(_scene(f'<default name="a0" value="ha"/>{_COPIES}<bsdf type="$a12"/>')), "expand"),
    "billion laughs by defaults in an included file": (
        _included(_scene('<default name="a0" value="ha"/><include filename="1.xml"/>'), _scene(_COPIES + '<bsdf type="$a12"/>')), "expand"),
    "billion laughs by includes": (
        _included(*[_scene(f'<include filename="{i + 1}.xml"/>' * 10) for i in range(9)], _scene("")), "more than 1000 files"),
    "an external entity": (_file('<!DOCTYPE s [<!ENTITY f SYSTEM "/etc/passwd">]>' + _scene(_diffuse("rgb", "&f;"))), "&f;"),
    "files that include each other": (
        _included(_scene('<include filename="1.xml"/>'), _scene('<include filename="0.xml"/>')), "recursion"),
    "a null character": (_file(b'<scene version="3.0.0">\0</scene>'), "null character"),
    "bytes that are no UTF-8": (_file('<scene version="3.0.0"><bsdf type="\xe9" id="a"/></scene>'.encode("latin-1")), "UTF-8"),
    "a device included": (_included(_scene('<include filename="/dev/zero"/>')), "not a regular file"),
    "a device as spectrum": (_file(_scene(_SHAPE.format('<bsdf type="diffuse"><spectrum name="reflectance" filename="/dev/zero"/></bsdf>'))),
                             "not a regular file"),
    "a device as mesh": (_file(_scene('<shape type="ply"><string name="filename" value="/dev/zero"/></shape>')), "/dev/zero"),
    "a folder as mesh": (_file(_scene('<shape type="ply"><string name="filename" value="."/></shape>')), "not found"),
    "a device as scene": (lambda folder: rt.load_file("/dev/zero"), "not found"),
    "an address as scene": (lambda folder: rt.load_file("http://example.org/scene.xml"), "not found"),
    "an address as mesh": (_file(_scene('<shape type="ply"><string name="filename" value="http://a.org/b.ply"/></shape>')), "an address"),
    "an address included": (_included(_scene('<include filename="https://a.org/b.xml"/>')), "an address"),
    "a name of 100,000 characters": (_file(_scene(f'<shape type="ply"><string name="filename" value="{"a" * 100_000}"/></shape>')), "not found"),
    # Dicts.
    "None in a dict": (_dict(s={"type": "sphere", "radius": None}), "NoneType"),
    "None as the height of a film": (_dict(c={"type": "perspective", "film": {"type": "hdrfilm", "height": None}}), "NoneType"),
    "a list in itself": (_dict(s={"type": "sphere", "center": (lambda row: row.append(row) or row)([])}), "list of numbers"),
    "a dict without type": (_dict(s={}), "no 'type'"),
    "a number as key": (_dict(s={"type": "sphere", 3: 1}), "no name"),
    "settings that are a list": (lambda folder: rt.load_dict({"type": "scene"}, [1]), "dict of names"),
    "a spectrum device in a dict": (_dict(e={"type": "point", "intensity": {"type": "spectrum", "filename": "/dev/zero"}}), "regular file"),
    # Numbers that no renderer can use.
    **{f"albedo {v}": (_file(_scene(_diffuse("rgb", v))), "reflectance") for v in ("nan", "inf", "-1", "2", "0 nan 0")},
    **{f"reflectance {v}": (_file(_scene(_diffuse("float", v))), "reflectance") for v in ("nan", "inf", "-0.5", "1e400")},
    **{f"radius {v}": (_file(_scene(_SHAPE.format(_property("float", "radius", v)))), "radius") for v in ("nan", "inf", "-1", "0")},
    **{f"radius {v} at a scale": (_file(_scene(_SHAPE.format(_property("float", "radius", v)))), "to_world") for v in ("1e38", "1e-40")},
    **{f"fov {v}": (_file(_sensor(_property("float", "fov", v))), "fov") for v in ("nan", "inf", "0", "-40", "180", "1e400")},
    **{f"ior {v}": (_file(_scene(_SHAPE.format(f'<bsdf type="dielectric">{_property("float", "int_ior", v)}</bsdf>'))), "int_ior")
       for v in ("0", "-1.5", "nan", "inf")},
    **{f"width {v}": (_file(_film("width", v)), "width") for v in ("0", "-4", "1000000000", "4294967296", "9223372036854775807")},
    "a width past 64 bits": (_file(_film("width", "18446744073709551616")), "integer"),
    "crop past the film": (_file(_film("crop_offset_x", "100000")), "crop"),
    "a film of 2^20 x 2^20": (_render(size=(1 << 20, 1 << 20)), "film"),
    "a film of 10^9 x 10^9": (_render(size=(10**9, 10**9)), "film"),
    "10^12 samples": (_render(spp=10**12), "spp"),
    "2^31 - 1 samples of a large film": (_render(spp=2**31 - 1, size=(1000, 1000)), "passes"),
    "sample_count 10^12": (_file(_sensor(f'<sampler type="independent">{_property("integer", "sample_count", "1000000000000")}</sampler>')),
                           "sample_count"),
    "a light of NaN": (_file(_scene('<emitter type="point"><rgb name="intensity" value="nan"/></emitter>')), "intensity"),
    "a negative light": (_file(_scene('<emitter type="constant"><rgb name="radiance" value="-1"/></emitter>')), "radiance"),
    "to_world of NaN": (_file(_scene(_SHAPE.format('<transform name="to_world"><scale value="nan"/></transform>'))), "to_world"),
    "to_world that is singular": (_file(_scene(_SHAPE.format('<transform name="to_world"><scale z="0"/></transform>'))), "invertible"),
    # Headers that announce more than follows.
    "ply of 10^15 vertices": (_mesh("ply", _PLY.format("binary_little_endian", 10**15, 1).encode()), "announced"),
    "ascii ply of 10^15 faces": (_mesh("ply", _PLY.format("ascii", 0, 10**15).encode()), "announced"),
    "serialized of 2^60 vertices": (_mesh("serialized", struct.pack("<HH", 0x41C, 4) + zlib.compress(struct.pack("<IBQQ", 0x1000, 0, 1 << 60, 1))),
                                    "speaks of"),
    "png of 10^5 x 10^5": (_image("bomb.png", _png(100_000, 100_000)), "too many pixels"),
    "exr of 10^5 x 10^5": (_image("bomb.exr", b"\x76\x2f\x31\x01\x02\0\0\0" + b"channels\0chlist\0" + struct.pack("<I", 19) + b"Y\0"
                                  + struct.pack("<4i", 1, 0, 1, 1) + b"\0" + b"dataWindow\0box2i\0" + struct.pack("<I4i", 16, 0, 0, 99_999, 99_999)
                                  + b"\0" * 9), "pixels"),
    "ply whose face index wraps": (_mesh("ply", fuzz_seeds.ply("ascii").replace(b"\n3 0 1 4", b"\n3 0 1 4294967296")), "cannot read"),
    "obj whose face index wraps": (_mesh("obj", fuzz_seeds.obj().replace(b"f 1/1/1", b"f 4294967297/1/1")), "vertex"),
    # Arrays and settings.
    "faces of -1": (lambda folder: rt.TriangleMesh(fuzz_seeds.VERTICES, [[0, 1, -1]]), "index -1"),
    "faces of 2^32": (lambda folder: rt.TriangleMesh(fuzz_seeds.VERTICES, [[0, 1, 2**32]]), "index 4294967296"),
    "faces of infinity": (lambda folder: rt.TriangleMesh(fuzz_seeds.VERTICES, [[0, 1, np.inf]]), "integers"),
    "vertices that are complex": (lambda folder: rt.TriangleMesh(fuzz_seeds.VERTICES + 1j, fuzz_seeds.FACES), "complex"),
    "vertices that are masked": (lambda folder: rt.TriangleMesh(np.ma.array(fuzz_seeds.VERTICES, mask=True), fuzz_seeds.FACES), "masked"),
    "vertices that are text": (lambda folder: rt.TriangleMesh(fuzz_seeds.VERTICES.astype(str), fuzz_seeds.FACES), "real numbers"),
    "a radius of NaN": (lambda folder: rt.Sphere.at((0, 0, 0), np.nan), "radius"),
    "a radius of -1": (lambda folder: rt.Sphere.at((0, 0, 0), -1), "radius"),
    "a rectangle of 1e38": (lambda folder: rt.Rectangle(np.diag([1e38, 1e38, 1e38, 1.0])), "1e+38"),
    "a centre of two numbers": (lambda folder: rt.Sphere.at((1, 2), 1.0), "centre"),
    "hits of too few entries": (_hit(prim=[0, 1, 2]), "entries"),
    "hits of no entries": (_hit(surface=[]), "entries"),
    "a mask of too few entries": (
        lambda folder: rt.TriangleMesh(fuzz_seeds.VERTICES, fuzz_seeds.FACES).occluded(rt.Ray(np.zeros((4, 3)), [0, 0, 1]), [True] * 3),
        "entries"),
    "a ray that is None": (lambda folder: rt.Sphere.at().intersect(None), "a Ray is needed"),
    "a structure that is no name": (_render(accel=["bvh"]), "accel"),
    "a size of one number": (_render(size=4), "size"),
    "a seed that is text": (_render(seed="x"), "seed"),
    "a scene that is a path": (lambda folder: rt.render("scene.xml"), "takes a Scene"),
}  # fmt: skip
