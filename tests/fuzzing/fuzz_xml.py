# ruff: noqa: E501 -- a case a line
"""Damage to scenes: numbers, attributes, tags and references that are wrong, and text that is no XML."""

from __future__ import annotations

import copy
import random
import xml.etree.ElementTree as ET
from collections.abc import Iterator

from fuzz_bytes import NUMBERS, damaged
from fuzz_seeds import SCENES

_TAGS = (
    "float", "integer", "string", "boolean", "rgb", "spectrum", "point", "vector", "transform", "shape", "bsdf", "texture",
    "emitter", "sensor", "film", "sampler", "rfilter", "integrator", "ref", "include", "alias", "default", "path", "scene",
    "lookat", "scale", "rotate", "translate", "matrix", "medium", "volume", "phase", "object", "x",
)  # fmt: skip
_TYPES = (
    "sphere", "disk", "rectangle", "cube", "cylinder", "ply", "obj", "serialized", "shapegroup", "instance", "diffuse",
    "conductor", "dielectric", "thindielectric", "twosided", "mask", "bitmap", "checkerboard", "mesh_attribute", "uniform",
    "srgb", "rawconstant", "d65", "point", "spot", "directional", "constant", "envmap", "area", "perspective", "thinlens",
    "orthographic", "hdrfilm", "independent", "stratified", "multijitter", "ldsampler", "box", "tent", "gaussian",
    "mitchell", "catmullrom", "lanczos", "path", "direct", "aov", "roughplastic", "volpath", "scene", "", "../x", "hair",
)  # fmt: skip
_NAMES = (
    "radius", "center", "to_world", "filename", "reflectance", "fov", "focal_length", "width", "height", "crop_width",
    "sample_count", "max_depth", "int_ior", "eta", "k", "scale", "intensity", "radiance", "position", "direction", "id", "",
    "type", "_arg_0", "value", "near_clip", "far_clip", "shape_index", "stddev", "lobes", "B", "principal_point_offset_x",
)  # fmt: skip
_STRINGS = (
    "", " ", "\t\n", "nowhere.ply", "/etc", ".", "..", "/dev/zero", "/dev/null", "http://example.org/a.ply", "file:///etc/passwd",
    "a" * 100_000, "$x", "\\$x", "$", "é\u202e\U0001f600", "%s%n", "&amp;", "mesh.ply", "tex.png", "part.xml", "env.exr", "\x7f",
    "mesh.ply/", "./mesh.ply", "red", "group", "picture", "floor",
)  # fmt: skip


def poisoned(poison: str) -> Iterator[tuple[str, str]]:
    """Every scene once for each number in it, with ``poison`` in that number's place; and which number that is."""
    for name, text in SCENES.items():
        count = len(_numbers(ET.fromstring(text)))
        for index in range(count):
            root = ET.fromstring(text)
            element, key, word = _numbers(root)[index]
            words = element.attrib[key].replace(",", " ").split()
            words[word] = poison
            element.attrib[key] = (", " if element.tag == "lookat" else " ").join(words)
            yield f"{name}: {element.tag} {element.attrib.get('name', '')} {key}[{word}]", ET.tostring(root, "unicode")


def _numbers(root: ET.Element) -> list[tuple[ET.Element, str, int]]:
    keys = ("value", "x", "y", "z", "angle", "origin", "target", "up")
    plain = ("float", "integer", "rgb", "point", "vector", "lookat", "scale", "rotate", "translate", "matrix")
    found = [(e, key) for e in root.iter() if e.tag in plain for key in e.attrib if key in keys]
    return [
        (e, key, i) for e, key in found for i, word in enumerate(e.attrib[key].replace(",", " ").split()) if word[0] != "$"
    ]  # fmt: skip


def xml_case(rng: random.Random) -> bytes:
    """A scene that something was done to."""
    text = SCENES[rng.choice(list(SCENES))]
    if rng.random() < 0.25:
        return damaged(text.encode(), rng)
    root = ET.fromstring(text)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        rng.choice(_MUTATIONS)(root, rng)
    data = ET.tostring(root, encoding="utf-8")
    return damaged(data, rng) if rng.random() < 0.03 else data


def _any(root: ET.Element, rng: random.Random) -> ET.Element:
    return rng.choice(list(root.iter()))


def _inner(root: ET.Element, rng: random.Random) -> tuple[ET.Element, ET.Element]:
    """Some element with its parent."""
    pairs = [(parent, child) for parent in root.iter() for child in parent]
    return rng.choice(pairs) if pairs else (root, root)


def _number(root: ET.Element, rng: random.Random) -> None:
    keys = ("value", "x", "y", "z", "angle", "origin", "target", "up")
    found = [(e, key) for e in root.iter() if e.tag not in ("string", "default") for key in e.attrib if key in keys]
    if not found:
        return
    element, key = rng.choice(found)
    words = element.attrib[key].replace(",", " ").split()
    words = words or [""]
    words[rng.randrange(len(words))] = rng.choice(NUMBERS)
    if rng.random() < 0.1:
        words = words[: rng.randrange(len(words) + 1)] if rng.random() < 0.5 else words * 3
    element.attrib[key] = " ".join(words)


def _string(root: ET.Element, rng: random.Random) -> None:
    found = [(e, key) for e in root.iter() for key in e.attrib]
    element, key = rng.choice(found)
    element.attrib[key] = rng.choice(_STRINGS)


def _drop_attribute(root: ET.Element, rng: random.Random) -> None:
    element, key = rng.choice([(e, key) for e in root.iter() for key in e.attrib])
    del element.attrib[key]


def _rename_attribute(root: ET.Element, rng: random.Random) -> None:
    element, key = rng.choice([(e, key) for e in root.iter() for key in e.attrib])
    element.attrib[rng.choice(("name", "value", "id", "type", "x", "filename", "nonsense"))] = element.attrib.pop(key)


def _swap_values(root: ET.Element, rng: random.Random) -> None:
    found = [(e, key) for e in root.iter() for key in e.attrib]
    (a, i), (b, j) = rng.choice(found), rng.choice(found)
    a.attrib[i], b.attrib[j] = b.attrib[j], a.attrib[i]


def _retype(root: ET.Element, rng: random.Random) -> None:
    found = [e for e in root.iter() if "type" in e.attrib]
    if found:
        rng.choice(found).attrib["type"] = rng.choice(_TYPES)


def _rename(root: ET.Element, rng: random.Random) -> None:
    found = [e for e in root.iter() if "name" in e.attrib]
    if found:
        rng.choice(found).attrib["name"] = rng.choice(_NAMES)


def _retag(root: ET.Element, rng: random.Random) -> None:
    _any(root, rng).tag = rng.choice(_TAGS)


def _delete(root: ET.Element, rng: random.Random) -> None:
    parent, child = _inner(root, rng)
    if parent is not child:
        parent.remove(child)


def _duplicate(root: ET.Element, rng: random.Random) -> None:
    parent, child = _inner(root, rng)
    for _ in range(rng.choice((1, 1, 2, 30))):
        parent.append(copy.deepcopy(child))


def _move(root: ET.Element, rng: random.Random) -> None:
    parent, child = _inner(root, rng)
    places = [e for e in root.iter() if e not in list(child.iter())]
    if parent is not child:
        parent.remove(child)
        rng.choice(places).append(child)


def _shuffle(root: ET.Element, rng: random.Random) -> None:
    element = _any(root, rng)
    children = list(element)
    rng.shuffle(children)
    element[:] = children


def _wrap(root: ET.Element, rng: random.Random) -> None:
    parent, child = _inner(root, rng)
    if parent is child:
        return
    index = list(parent).index(child)
    parent.remove(child)
    for _ in range(rng.choice((1, 2, 40, 200))):
        outer = ET.Element(
            rng.choice(("bsdf", "shape", "texture")), type=rng.choice(("twosided", "mask", "checkerboard"))
        )
        outer.append(child)
        child = outer
    parent.insert(index, child)


def _refer(root: ET.Element, rng: random.Random) -> None:
    ids = [e.attrib["id"] for e in root.iter() if "id" in e.attrib] + ["nowhere"]
    found = [e for e in root.iter() if "type" in e.attrib]
    if found:
        element = rng.choice(found)
        if rng.random() < 0.4:
            element.attrib["id"] = rng.choice([*ids, "self"])
            ids.append("self")
        ET.SubElement(
            element, "ref", id=rng.choice(ids), **({"name": rng.choice(_NAMES)} if rng.random() < 0.3 else {})
        )


def _add(root: ET.Element, rng: random.Random) -> None:
    value = rng.choice(NUMBERS) if rng.random() < 0.6 else rng.choice(_STRINGS)
    ET.SubElement(_any(root, rng), rng.choice(_TAGS[:9]), name=rng.choice(_NAMES), value=value)


def _add_object(root: ET.Element, rng: random.Random) -> None:
    tag = rng.choice(("shape", "bsdf", "emitter", "texture", "sensor", "film", "sampler", "integrator", "rfilter"))
    ET.SubElement(
        _any(root, rng), tag, type=rng.choice(_TYPES), **({"name": rng.choice(_NAMES)} if rng.random() < 0.3 else {})
    )


_MUTATIONS = (
    _number, _number, _number, _number, _number, _string, _string, _drop_attribute, _rename_attribute, _swap_values, _retype,
    _retype, _rename, _retag, _delete, _duplicate, _move, _shuffle, _wrap, _refer, _add, _add_object,
)  # fmt: skip
