"""Gradients by every parameter at once are finite where surfaces, lights and materials are at their extremes."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import drjit as dr
import gradient_scenes as scenes
import numpy as np
import pytest

import raytrace2 as rt


def camera(origin: list[float], target: list[float], up: list[float], **more: Any) -> dict[str, Any]:
    """The camera elsewhere."""
    to_world = scenes.transforms()().look_at(origin, target, up)
    return {**scenes.scene_dict()["sensor"], "to_world": to_world, **more}


def painted(shape: str, pixels: np.ndarray = scenes.PIXELS, **more: Any) -> dict[str, Any]:
    """A shape with a texture."""
    import mitsuba as mi

    scenes.transforms()
    image = {"type": "bitmap", "bitmap": mi.Bitmap(pixels.astype(np.float32)), "raw": True}
    return {"type": shape, "bsdf": {"type": "diffuse", "reflectance": image}, **more}


def ball(**bsdf: Any) -> dict[str, Any]:
    """The ball of another material."""
    return {"ball": {**scenes.scene_dict()["ball"], "bsdf": bsdf}}


def scaled(size: float, offset: float = 0.0) -> dict[str, Any]:
    """Everything larger and elsewhere."""
    T = scenes.transforms()
    moved = T().translate([offset] * 3).scale(size)
    plain = scenes.scene_dict()
    shapes = {k: {**plain[k], "to_world": moved @ plain[k]["to_world"]} for k in ("floor", "ball", "box")}
    places = np.array([[0.3, -3, 2], [0, 0, 0.3], [0.5, -1, 3]]) * size + offset
    light = {"type": "rgb", "value": [5 * size**2] * 3}
    lens = {"near_clip": 1e-3 * size, "far_clip": 1e3 * size}
    return shapes | {
        "sensor": camera(*places[:2].tolist(), [0, 0, 1], **lens),
        "lamp": {"type": "point", "position": places[2].tolist(), "intensity": light},
    }


def lamp(z: float, *color: float) -> dict[str, Any]:
    """The lamp elsewhere, of another colour."""
    return {"lamp": {"type": "point", "position": [0.5, -1, z], "intensity": {"type": "rgb", "value": list(color)}}}


def masked(opacity: float) -> dict[str, Any]:
    """A box that may let all light through."""
    bsdf = {"type": "mask", "opacity": opacity, "n": {"type": "diffuse"}}
    return {"box": {**scenes.scene_dict()["box"], "bsdf": bsdf}}


def relief(kind: str, pixels: np.ndarray) -> dict[str, Any]:
    """A ball of rough metal under a map of relief."""
    import mitsuba as mi

    scenes.transforms()
    image = {"type": "bitmap", "bitmap": mi.Bitmap(pixels.astype(np.float32)), "raw": True}
    metal = {"type": "roughconductor", "alpha": 0.2}
    return ball(type=kind, **{"normalmap" if kind == "normalmap" else "texture": image, "n": metal})


def emitting(shape: str, size: float, z: float, **more: Any) -> dict[str, Any]:
    """A shape in place of the lamp."""
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": [3, 4, 5]}}
    at = scenes.transforms()().translate([0.5, -1, z]).rotate([1, 0, 0], 180).scale(size)
    return {"lamp": {"type": shape, "to_world": at, "emitter": emitter, **more}}


def folded(emits: bool) -> dict[str, Any]:
    """A mesh, which may emit, with faces of no area, vertices at one place, opposite normals and uv of one point."""
    path = Path(tempfile.mkdtemp()) / "folded.obj"
    vertices = [(-1, -1), (1, -1), (1, 1), (1, 1), (0, 0), (0, 0)]
    rows = [f"v {x} {y} 0" for x, y in vertices] + ["vt 0.5 0.5", "vt 0 0", "vt 1 0", "vn 0 0 1", "vn 0 0 -1"]
    faces = ["1/2/1 2/3/1 3/1/1", "1/1/1 3/1/1 4/1/1", "1/1/2 5/1/2 3/1/2", "2/1/1 5/2/2 6/3/1"]
    path.write_text("\n".join([*rows, *(f"f {face}" for face in faces)]) + "\n")
    if emits:
        return emitting("obj", 0.5, 3.0, filename=str(path))
    at = scenes.transforms()().translate([0.6, 0, 0.5])
    return {"ball": painted("obj", filename=str(path), to_world=at)}


def sky(pixels: np.ndarray) -> dict[str, Any]:
    """A sky in place of the lamp."""
    import mitsuba as mi

    scenes.transforms()
    return {"lamp": {"type": "envmap", "bitmap": mi.Bitmap(pixels.astype(np.float32))}}


SPIKE = np.pad(np.full((1, 1, 3), 1e6), ((2, 3), (3, 4), (0, 0)))
EXTREMES: dict[str, Any] = {
    "tiny": lambda: scaled(1e-6),
    "huge": lambda: scaled(1e6),
    "far": lambda: scaled(1.0, 1e5),
    "in the plane of the floor": lambda: {"sensor": camera([0, -5, 0], [0, 3, 0], [0, 0, 1])},
    "grazing": lambda: {"sensor": camera([0, -2.9, 1e-4], [0, 3, 0], [0, 0, 1])},
    "pole": lambda: {"ball": painted("sphere"), "sensor": camera([0, 0, 4], [0, 0, 0], [0, 1, 0], fov=15)},
    "centre of a disk": lambda: {"ball": painted("disk"), "sensor": camera([0, 0, 4], [0, 0, 0], [0, 1, 0], fov=15)},
    "black": lambda: {"floor": painted("rectangle", np.zeros((5, 5, 3)))},
    "white": lambda: {"floor": painted("rectangle", np.ones((5, 5, 3)))},
    "no light": lambda: lamp(3.0, 0, 0, 0),
    "light in the floor": lambda: lamp(0.0, 5, 6, 7),
    "sharp metal": lambda: ball(type="roughconductor", alpha=0.0),
    "rough metal": lambda: ball(type="roughconductor", alpha=1.0),
    "glass that does not refract": lambda: ball(type="dielectric", int_ior=1.0, ext_ior=1.0),
    "strong glass": lambda: ball(type="dielectric", int_ior=10.0, ext_ior=1.0),
    "pane that is not there": lambda: ball(type="thindielectric", int_ior=1.0, ext_ior=1.0),
    "transparent": lambda: masked(0.0),
    "opaque": lambda: masked(1.0),
}
MORE: dict[str, Any] = {
    "normals of no length": lambda: relief("normalmap", np.full((4, 4, 3), 0.5)),
    "flat normals": lambda: relief("normalmap", np.full((4, 4, 3), [0.5, 0.5, 1.0])),
    "normals from behind": lambda: relief("normalmap", np.zeros((4, 4, 3))),
    "no relief": lambda: relief("bumpmap", np.zeros((4, 4, 1))),
    "steep relief": lambda: relief("bumpmap", 1e6 * np.random.default_rng(1).random((4, 4, 1))),
    "one texel": lambda: {"floor": painted("rectangle", np.full((1, 1, 3), 0.5))},
    "folded mesh": lambda: folded(False),
    "folded light": lambda: folded(True),
    "light around everything": lambda: emitting("sphere", 50.0, 0.0, flip_normals=True),
    "light of next to no size": lambda: emitting("sphere", 1e-6, 3.0),
    "sheet of light of next to no size": lambda: emitting("rectangle", 1e-6, 3.0),
    "light on the floor": lambda: emitting("rectangle", 0.5, 0.0),
    "black sky": lambda: sky(np.zeros((4, 8, 3))),
    "spike in the sky": lambda: sky(SPIKE),
    "pinhole of a lens": lambda: {
        "sensor": {**scenes.scene_dict()["sensor"], "type": "thinlens", "aperture_radius": 1e-9, "focus_distance": 3.0}
    },
    "conductor like air": lambda: ball(type="conductor", eta=1.0, k=0.0),
}


#: Kernels that move everything take long to compile: with RAYTRACE2_ALL_GRADIENTS=1, all of them, with every filter.
FILTERS: tuple[str, ...] = ("bilinear",)
if os.environ.get("RAYTRACE2_ALL_GRADIENTS"):
    EXTREMES |= MORE
    FILTERS += (
        "nearest",
        "bicubic",
        "trilinear",
        "trilinear_shorter",
        "ewa",
        "probes",
        "exact",
        "exact2",
        "stochastic",
    )


def wrong(things: dict[str, Any], precision: str = "float32", **how: Any) -> list[str]:
    """The parameters whose gradients are not finite, all of them moving at once."""
    scene = rt.load_dict(scenes.scene_dict(**things))
    params = rt.traverse(scene, precision)
    for key in params.keys():
        dr.enable_grad(params[key])
    params.update()
    dr.backward(dr.sum(rt.render(scene, params, spp=4, seed=1, accel="brute_force", **how), axis=None))
    return [key for key in params.keys() if not np.isfinite(dr.grad(params[key]).numpy()).all()]


@pytest.mark.parametrize("filter", FILTERS)
@pytest.mark.parametrize("case", EXTREMES)
def test_gradients_are_finite(case: str, filter: str) -> None:
    things = EXTREMES[case]() | {"integrator": {"type": "path", "max_depth": 3}}
    assert not wrong(things, filter=filter)


@pytest.mark.parametrize("case", ["pole", "in the plane of the floor"])
def test_gradients_through_footprints_are_finite(case: str) -> None:
    assert not wrong(EXTREMES[case]() | {"integrator": {"type": "direct"}}, filter="ewa")
