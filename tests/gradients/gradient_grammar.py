"""A grammar of small scenes: every kind of shape, material, light and camera, with parameters of every kind.

Differences of renders at fixed samples tell their derivatives: along directions of :func:`direction`.
"""

from __future__ import annotations

import functools
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np

import raytrace2 as rt

Dict = dict[str, Any]
RNG = np.random.default_rng(11)
COLOR = (0.1 + 0.8 * RNG.random((7, 6, 3))).astype(np.float32)
GREY = (0.2 + 0.6 * RNG.random((5, 7, 1))).astype(np.float32)
SKY = (0.2 + RNG.random((6, 8, 3))).astype(np.float32)
NORMALS = (0.5 + 0.5 * np.array([0.1, -0.1, 0.9]) + 0.1 * RNG.random((6, 6, 3))).astype(np.float32)


@dataclass(frozen=True)
class Spec:
    """A scene: up to four ``things``, each a shape and a material, on a textured floor; ``lights``; a ``camera``; what
    it is rendered with."""

    things: tuple[tuple[str, str], ...]
    lights: tuple[str, ...]
    camera: str = "perspective"
    integrator: str = "path"
    filter: str | None = None
    differentials: str | None = None

    def __str__(self) -> str:
        things = "+".join(f"{shape}.{material}" for shape, material in self.things)
        return " ".join([things, "+".join(self.lights), self.camera, self.integrator, self.filter or ""]).strip()

    def load(self) -> rt.Scene:
        """The scene."""
        return rt.load_dict(scene_dict(self))

    def how(self) -> Dict:
        """Arguments of ``rt.render``."""
        return {"filter": self.filter, "differentials": self.differentials, "spp": 1, "accel": "brute_force"}


def mitsuba() -> Any:
    """Mitsuba, for its transforms and bitmaps."""
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    return mi


def bitmap(pixels: np.ndarray, **more: Any) -> Dict:
    """A bitmap texture."""
    return {"type": "bitmap", "bitmap": mitsuba().Bitmap(pixels), "raw": True, **more}


def rgb(*color: float) -> Dict:
    """A colour."""
    return {"type": "rgb", "value": list(color)}


@functools.cache
def mesh_file() -> str:
    """A bulging sheet of 18 triangles with normals and uv, an OBJ file."""
    n, rows = 4, []
    grid = [(i / (n - 1) * 2 - 1, j / (n - 1) * 2 - 1) for j in range(n) for i in range(n)]
    for x, y in grid:
        rows.append(f"v {x} {y} {0.5 - 0.3 * x * x - 0.2 * y * y + 0.1 * x * y}")
    for x, y in grid:
        rows.append(f"vt {0.5 + 0.4 * x + 0.05 * x * y} {0.5 + 0.45 * y}")
    for x, y in grid:
        rows.append(f"vn {0.6 * x - 0.1 * y} {0.4 * y - 0.1 * x} 1")
    for j in range(n - 1):
        for i in range(n - 1):
            a = j * n + i + 1
            for corners in ((a, a + 1, a + n), (a + 1, a + n + 1, a + n)):
                rows.append("f " + " ".join(f"{c}/{c}/{c}" for c in corners))
    path = Path(tempfile.mkdtemp()) / "sheet.obj"
    path.write_text("\n".join(rows) + "\n")
    return str(path)


def shape(kind: str, to_world: Any, **more: Any) -> Dict:
    """A shape of about the size of the unit sphere."""
    T = mitsuba().ScalarTransform4f
    if kind == "flat":
        return {"type": "cube", "to_world": to_world @ T().rotate([0.36, 0.8, 0.48], 25).scale(0.7), **more}
    if kind == "smooth":
        return {"type": "obj", "filename": mesh_file(), "to_world": to_world, **more}
    if kind == "faces":
        return {"type": "obj", "filename": mesh_file(), "face_normals": True, "to_world": to_world, **more}
    # Mitsuba's transforms have the digits of float32, with which a turned sphere is none in float64.
    turned = to_world if kind == "sphere" else to_world @ T().rotate([0.48, 0.8, 0.36], 25)
    return {"type": kind, "to_world": turned, **more}


def material(kind: str) -> Dict:
    """A material with parameters of its own."""
    grey: Dict = {"type": "diffuse", "reflectance": rgb(0.5, 0.4, 0.3)}
    T = mitsuba().ScalarTransform3f
    match kind:
        case "diffuse":
            return grey
        case "texture":
            return {"type": "diffuse", "reflectance": bitmap(COLOR, to_uv=T().scale([1.3, 0.9]))}
        case "checker":
            colors = {"color0": rgb(0.2, 0.3, 0.4), "color1": rgb(0.8, 0.7, 0.5)}
            return {"type": "diffuse", "reflectance": {"type": "checkerboard", **colors, "to_uv": T().scale([3, 4])}}
        case "conductor":
            return {"type": "conductor", "eta": rgb(1.2, 1.0, 0.8), "k": rgb(6, 5, 4), "specular_reflectance": 0.9}
        case "ggx":
            alpha = bitmap(GREY)
            index = {"eta": rgb(1.2, 1.0, 0.8), "k": rgb(6, 5, 4)}
            return {"type": "roughconductor", "distribution": "ggx", "alpha": alpha, **index}
        case "beckmann":
            rough = {"alpha_u": 0.2, "alpha_v": 0.35, "specular_reflectance": rgb(0.9, 0.8, 0.7)}
            return {"type": "roughconductor", "distribution": "beckmann", "material": "Cu", **rough}
        case "allnormals":
            rough = {"alpha": 0.3, "sample_visible": False}
            return {"type": "roughconductor", "distribution": "ggx", "material": "Al", **rough}
        case "dielectric":
            return {"type": "dielectric", "specular_reflectance": 0.9, "specular_transmittance": rgb(0.9, 0.8, 0.95)}
        case "thindielectric":
            return {"type": "thindielectric", "specular_transmittance": bitmap(COLOR)}
        case "twosided":
            return {"type": "twosided", "a": material("texture"), "b": {"type": "diffuse", "reflectance": 0.3}}
        case "mask":
            return {"type": "mask", "opacity": bitmap(GREY), "n": {"type": "diffuse", "reflectance": 0.6}}
        case "bumpmap":
            return {"type": "bumpmap", "t": bitmap(GREY), "scale": 0.2, "n": grey}
        case "normalmap":
            return {"type": "normalmap", "normalmap": bitmap(NORMALS), "n": material("beckmann")}
    raise KeyError(kind)


def light(kind: str) -> Dict:
    """A light above the scene, by name; ``area_`` with that of a shape."""
    T = mitsuba().ScalarTransform4f
    match kind:
        case "point":
            return {"type": "point", "position": [0.5, -1, 4], "intensity": rgb(9, 11, 12)}
        case "spot":
            look = T().look_at([1, -1.5, 5], [0, 0.2, 0], [0, 1, 0])
            return {
                "type": "spot", "intensity": rgb(30, 25, 20), "to_world": look, "texture": bitmap(COLOR),
                "cutoff_angle": 30.0, "beam_width": 12.0,
            }  # fmt: skip
        case "directional":
            return {"type": "directional", "direction": [0.3, 0.4, -1], "irradiance": rgb(2, 1.5, 1)}
        case "constant":
            return {"type": "constant", "radiance": rgb(0.5, 0.7, 0.9)}
        case "envmap":
            turn = T().rotate([0.36, 0.48, 0.8], 40)
            return {"type": "envmap", "bitmap": mitsuba().Bitmap(SKY), "scale": 1.5, "to_world": turn}
    area, _, kind = kind.partition("_")
    assert area == "area"
    radiance = bitmap(COLOR) if kind in ("smooth", "disk") else rgb(9, 8, 7)
    turned = T().translate([-0.4, -0.6, 4.5])
    turned = turned.scale(0.5) if kind == "sphere" else turned.rotate([0.96, 0.28, 0], 170).scale(0.8)
    # Black has a derivative on one side only.
    grey = {"type": "diffuse", "reflectance": rgb(0.3, 0.2, 0.25)}
    return shape(kind, turned, bsdf=grey, emitter={"type": "area", "radiance": radiance})


def camera(kind: str) -> Dict:
    """A camera that looks down on the scene."""
    T = mitsuba().ScalarTransform4f
    look = T().look_at([0.3, -5.0, 4.0], [0, 0, 0.4], [0, 0, 1])
    film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
    more = {
        "perspective": {"fov": 45, "principal_point_offset_x": 0.02},
        "thinlens": {"fov": 45, "aperture_radius": 0.08, "focus_distance": 5.5},
        "orthographic": {},
    }[kind]
    to_world = look @ T().scale([2.5, 2.5, 1]) if kind == "orthographic" else look
    return {"type": kind, "to_world": to_world, "film": film, **more}


def scene_dict(spec: Spec) -> Dict:
    """The scene as a Mitsuba dict."""
    T = mitsuba().ScalarTransform4f
    found: Dict = {"type": "scene", "sensor": camera(spec.camera)}
    if spec.integrator == "path":
        found["integrator"] = {"type": "path", "max_depth": 5, "rr_depth": 100}
    else:
        found["integrator"] = {"type": "direct"}
    found["floor"] = {
        "type": "rectangle",
        "to_world": T().scale([4, 4, 1]),
        "bsdf": {"type": "diffuse", "reflectance": bitmap(COLOR)},
    }
    places = [(-1.0, -0.8, 0.8), (1.1, -0.6, 0.9), (-0.9, 1.4, 0.9), (1.2, 1.5, 0.8)]
    for number, ((kind, surface), place) in enumerate(zip(spec.things, places, strict=False)):
        to_world = T().translate(list(place)).scale(0.75)
        name, bsdf = f"thing{number}", material(surface)
        if kind == "instance":
            inner = shape("smooth", T().scale(0.9), bsdf=bsdf)
            found[f"group{number}"] = {"type": "shapegroup", "inner": inner}
            found[name] = {"type": "instance", "to_world": to_world, "g": {"type": "ref", "id": f"group{number}"}}
        else:
            found[name] = shape(kind, to_world, bsdf=bsdf)
    for number, kind in enumerate(spec.lights):
        found[f"light{number}"] = light(kind)
    return found


def direction(key: str, value: Any, rng: np.random.Generator) -> np.ndarray:
    """A direction in which the parameter ``key`` may change from ``value``, a NumPy array of its shape."""
    before = value.numpy()
    if dr.is_matrix_v(value):
        before = before[..., 0]
        size = len(before)
        if size == 3:
            change = rng.normal(size=(3, 3))
            change[2] = 0
            return change
        turn = rng.normal(size=3)
        change = np.zeros((4, 4))
        change[:3, :3] = [[0, -turn[2], turn[1]], [turn[2], 0, -turn[0]], [-turn[1], turn[0], 0]]
        if not key.startswith("sensor"):
            change[:3, :3] += rng.normal() * np.eye(3)
        change[:3, 3] = rng.normal(size=3)
        return change @ before
    return rng.normal(size=before.shape) * (1 if before.size < 4 else 0.3)
