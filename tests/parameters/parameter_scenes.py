"""Scenes that hold every kind of parameter, as dicts."""

from __future__ import annotations

from typing import Any

import numpy as np

RNG = np.random.default_rng(7)
COLOR = RNG.random((5, 6, 3)).astype(np.float32)
GREY = RNG.random((4, 5, 1)).astype(np.float32)
SKY = RNG.random((6, 8, 3)).astype(np.float32)
NORMALS = (0.5 + 0.5 * np.array([0.2, 0.1, 0.9]) + 0.1 * RNG.random((4, 4, 3))).astype(np.float32)


def transforms() -> Any:
    """Mitsuba's transforms."""
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    return mi.ScalarTransform4f


def bitmap(pixels: np.ndarray, **more: Any) -> dict[str, Any]:
    """A bitmap texture."""
    import mitsuba as mi

    return {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "raw": True, **more}


def rgb(*color: float) -> dict[str, Any]:
    """A colour."""
    return {"type": "rgb", "value": list(color)}


def scene(**things: Any) -> dict[str, Any]:
    """A floor, a camera, a lamp, and ``things`` (which take the place of those of their names)."""
    T = transforms()
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 4},
        "sensor": {
            "type": "perspective",
            "fov": 50,
            "to_world": T().look_at([0.3, -3.0, 2.0], [0, 0, 0.3], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": 24, "height": 18, "filter": {"type": "box"}},
        },
        "floor": {
            "type": "rectangle",
            "to_world": T().scale([3, 3, 1]),
            "bsdf": {"type": "diffuse", "reflectance": bitmap(COLOR)},
        },
        "lamp": {"type": "point", "position": [0.5, -1, 3], "intensity": rgb(5, 6, 7)},
    } | things


def everything() -> dict[str, Any]:
    """One of each thing that has parameters."""
    T = transforms()
    return scene(
        mat={"type": "diffuse", "reflectance": rgb(0.1, 0.2, 0.3)},
        rough={"type": "roughconductor", "alpha": 0.2, "material": "Al"},
        ball={"type": "sphere", "center": [1, 0, 0.5], "radius": 0.5, "bsdf": {"type": "ref", "id": "mat"}},
        shining={"type": "sphere", "radius": 0.1, "emitter": {"type": "area", "radiance": 2.0}},
        plate={"type": "disk", "bsdf": {"type": "ref", "id": "rough"}},
        tube={"type": "cylinder", "p1": [1, 0, 0], "bsdf": {"type": "dielectric", "specular_reflectance": 0.9}},
        wall={"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": {"type": "checkerboard"}}},
        two={
            "type": "cube",
            "flip_normals": True,
            "bsdf": {"type": "twosided", "a": {"type": "diffuse"}, "b": {"type": "diffuse", "reflectance": 0.25}},
        },
        masked={"type": "cube", "bsdf": {"type": "mask", "opacity": 0.7, "n": {"type": "conductor"}}},
        bumpy={
            "type": "cube",
            "bsdf": {"type": "bumpmap", "t": bitmap(GREY), "n": {"type": "diffuse", "reflectance": 0.35}},
        },
        mapped={
            "type": "cube",
            "bsdf": {
                "type": "normalmap",
                "normalmap": bitmap(NORMALS),
                "n": {"type": "roughconductor", "alpha_u": 0.1, "alpha_v": 0.3},
            },
        },
        pane={"type": "cube", "bsdf": {"type": "thindielectric"}},
        group={"type": "shapegroup", "inner": {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": 0.45}}},
        copy={"type": "instance", "to_world": T().translate([1, 2, 3]), "g": {"type": "ref", "id": "group"}},
        spot={"type": "spot", "intensity": 3.0, "texture": bitmap(COLOR), "to_world": T().translate([0, 0, 4])},
        sun={"type": "directional", "direction": [0.2, 0.3, -1]},
        sky={"type": "envmap", "bitmap": bitmap(SKY)["bitmap"], "scale": 2.0},
        lens={"type": "thinlens", "aperture_radius": 0.1, "to_world": T().translate([1, 0, 0])},
        flat={"type": "orthographic", "to_world": T().scale(2)},
    )
