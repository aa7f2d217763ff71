# ruff: noqa: E501 -- a case a line
"""Damage to scene dicts: values of every Python type where a number, a string or an object is meant."""

from __future__ import annotations

import random
from typing import Any

import numpy as np

from raytrace2.scene.parse import mitsuba_types


def seed_dict() -> dict[str, Any]:
    """A scene that uses numbers, strings, colours, transforms, arrays, nested objects and references."""
    _, variant = mitsuba_types()
    T = variant.ScalarTransform4f
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3},
        "sensor": {
            "type": "perspective",
            "fov": 40.0,
            "to_world": T().look_at(origin=[0, 0, 5], target=[0, 0, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 4, "height": 4, "filter": {"type": "box"}},
            "sampler": {"type": "independent", "sample_count": 1},
        },
        "red": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.1, 0.1]}},
        "ball": {"type": "sphere", "center": [0.5, 0, 0], "radius": 1.0, "bsdf": {"type": "ref", "id": "red"}},
        "floor": {
            "type": "disk",
            "to_world": T().translate([0, -1, 0]).rotate([1, 0, 0], -80).scale(2),
            "bsdf": {
                "type": "diffuse",
                "reflectance": {"type": "bitmap", "data": variant.TensorXf(np.ones((2, 2, 3), np.float32) * 0.5)},
            },
        },
        "sky": {"type": "constant", "radiance": 1.0},
        "lamp": {"type": "point", "position": [0.0, 3.0, 3.0], "intensity": {"type": "spectrum", "value": 3.0}},
    }


def _values(rng: random.Random) -> Any:
    _, variant = mitsuba_types()
    T = variant.ScalarTransform4f
    loop: list[Any] = []
    loop.append(loop)
    makers: list[Any] = [
        None, True, False, 0, 1, -1, 2**31, 2**63, 2**64, 10**30, -(10**400), 0.0, -0.0, float("nan"), float("inf"), -1.0, 1e300,
        1e39, 1e-320, 3 + 4j, "", "x", "red", "nan", "a\0b", "a" * 100_000, "\ud800", "http://x.org/y.png", b"bytes", [], {}, (),
        [1, 2], [1, 2, 3], [1.0, float("nan"), 0.0], ["a", "b", "c"], [[1, 2, 3]], [None, None, None], loop, {1: 2},
        {"type": "sphere"}, {"type": "ref", "id": "nowhere"}, {"type": "ref", "id": "ball"}, {"type": "ref"}, {"type": "rgb"},
        {"type": "rgb", "value": float("nan")}, {"type": "rgb", "value": [1, 2]}, {"type": "rgb", "value": "x"},
        {"type": "spectrum", "value": [(400, 1), (300, 2)]}, {"type": "spectrum", "value": [(400, 1), (400, 2)]},
        {"type": "spectrum", "value": [(400, float("nan")), (500, 1)]}, {"type": "spectrum", "filename": "/dev/zero"},
        {"type": "spectrum", "value": []}, {"type": "spectrum", "value": [(400,)]}, {"type": "blackbody", "temperature": -1},
        {"type": "irregular", "wavelengths": "1,2", "values": "1"}, {"type": "scene"}, {"type": None}, {"type": 3}, {"no": "type"},
        {"type": "diffuse", "reflectance": -1.0}, {"type": "uniform", "value": float("nan")}, {"type": "mask"},
        object(), lambda: 0, int, {1, 2}, range(3), iter([1, 2]), np.float32(2.0), np.float64("nan"), np.int64(-3), np.bool_(True),
        np.array([1.0, 2.0, 3.0]), np.array([1, 2, 3]), np.array([np.nan] * 3), np.zeros((4, 4)), np.eye(4), np.zeros((0, 3)),
        np.zeros((2, 2, 3), np.uint8), np.full((2, 2, 3), np.nan, np.float32), np.zeros((2, 2, 7)), np.zeros((2, 2, 3), complex),
        np.array(["a", "b"]), np.array([object()]), np.zeros((1, 1, 1, 1)), T(), T().scale(0), T().scale(-1),
        T().scale(float("nan")), T().translate([float("inf"), 0, 0]), T().translate([1e30, 0, 0]), T().scale(1e-30),
        T(np.ones((4, 4))), T(np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 1, 0.0]])),
        variant.ScalarPoint3f(1, 2, 3), variant.ScalarColor3f(float("nan")), variant.ScalarTransform3f(),
    ]  # fmt: skip
    return rng.choice(makers)


_KEYS = (
    "type", "id", "radius", "to_world", "reflectance", "width", "fov", "value", "filename", "bitmap", "data", "", "a.b", "x\0y",
    "sample_count", "int_ior", "center", "shape", "bsdf", "emitter", 3, None, "_arg_0", "é",
)  # fmt: skip
_TYPES = (
    "sphere",
    "cube",
    "ply",
    "diffuse",
    "dielectric",
    "area",
    "perspective",
    "hdrfilm",
    "path",
    "",
    "x",
    "rgb",
    "ref",
    "scene",
)


def dict_case(rng: random.Random) -> Any:
    """A scene dict that something was done to."""
    scene = seed_dict()
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        places = list(_places(scene))
        node = rng.choice(places)
        key = rng.choice(list(node)) if node else "a"
        match rng.randrange(10):
            case 0 | 1 | 2 | 3:
                node[key] = _values(rng)
            case 4:
                node.pop(key, None)
            case 5:
                node[rng.choice(_KEYS)] = _values(rng)
            case 6:
                node[rng.choice(_KEYS)] = node.pop(key, None)
            case 7:
                node["type"] = rng.choice(_TYPES)
            case 8:
                node[key] = rng.choice([scene, node, rng.choice(places)])
            case _:
                other = rng.choice(places)
                if other:
                    node[key] = other[rng.choice(list(other))]
    return rng.choice((None, 3, [], "scene", {}, [scene])) if rng.random() < 0.01 else scene


def _places(node: dict[Any, Any], seen: set[int] | None = None) -> Any:
    seen = set() if seen is None else seen
    if id(node) in seen:
        return
    seen.add(id(node))
    yield node
    for value in node.values():
        if isinstance(value, dict):
            yield from _places(value, seen)
