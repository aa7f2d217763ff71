# ruff: noqa: E501 -- a case a line
"""Cases by kind and number: the same ones on every machine."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fuzz_api
import fuzz_bytes
import fuzz_dict
import fuzz_judge
import fuzz_seeds
import fuzz_xml

import raytrace2 as rt

MESHES = ("ply", "obj", "serialized")
IMAGES = ("png", "jpg", "bmp", "exr")
KINDS = ("xml", "dict", *MESHES, *IMAGES, "api")

_MESH_SCENE = f"""<scene version="3.0.0"><integrator type="direct"/>{fuzz_seeds.VIEW}
<shape type="%s"><string name="filename" value="%s"/></shape><emitter type="constant"/></scene>"""
_IMAGE_SCENE = f"""<scene version="3.0.0"><integrator type="direct"/>{fuzz_seeds.VIEW}<shape type="rectangle"><bsdf type="diffuse">
<texture type="bitmap" name="reflectance"><string name="filename" value="%s"/></texture></bsdf></shape><emitter type="constant"/></scene>"""
_ENVIRONMENT_SCENE = f"""<scene version="3.0.0"><integrator type="direct"/>{fuzz_seeds.VIEW}
<emitter type="envmap"><string name="filename" value="%s"/></emitter></scene>"""


def run(kind: str, number: int, folder: Path) -> tuple[str, str]:
    """What becomes of case ``number`` of ``kind``: one of the classes of :mod:`fuzz_judge`, and the message."""
    return fuzz_judge.judge(prepare(kind, number, folder))


def prepare(kind: str, number: int, folder: Path) -> Callable[[], Any]:
    """The case as a call; its files are written to ``folder``."""
    rng = random.Random(f"{kind} {number}")
    if kind == "api":
        return fuzz_api.api_case(rng)
    if kind == "dict":
        scene = fuzz_dict.dict_case(rng)
        return lambda: fuzz_judge.render_small(rt.load_dict(scene))
    data = case_bytes(kind, rng, folder)
    if kind == "xml":
        return scene_call(data, folder)
    return file_call(kind, data, folder, rng.random() < 0.3)


def case_bytes(kind: str, rng: random.Random, folder: Path) -> bytes:
    """The damaged file."""
    if kind == "xml":
        return fuzz_xml.xml_case(rng)
    data = rng.choice(fuzz_seeds.seeds_of(kind, folder))
    return fuzz_bytes.damaged(data, rng)


def scene_call(data: bytes, folder: Path) -> Callable[[], Any]:
    """Loading and rendering a scene file of these bytes, beside the files that the seeds name."""
    if not (folder / "part.xml").exists():
        fuzz_seeds.write_files(folder)
    path = folder / "scene.xml"
    path.write_bytes(data)
    return lambda: fuzz_judge.render_small(rt.load_file(path))


def file_call(kind: str, data: bytes, folder: Path, as_environment: bool = False) -> Callable[[], Any]:
    """Loading and rendering a scene around a mesh or an image of these bytes."""
    folder.mkdir(parents=True, exist_ok=True)
    name = f"case.{kind}"
    (folder / name).write_bytes(data)
    if kind in MESHES:
        xml = _MESH_SCENE % (kind, name)
    else:
        xml = (_ENVIRONMENT_SCENE if as_environment else _IMAGE_SCENE) % name
    (folder / "around.xml").write_text(xml)
    return lambda: fuzz_judge.render_small(rt.load_file(folder / "around.xml"))
