"""Gradients by every parameter at once are finite where surfaces, lights and materials are at their extremes."""

from __future__ import annotations

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


@pytest.mark.parametrize("case", EXTREMES)
def test_gradients_are_finite(case: str) -> None:
    things = EXTREMES[case]() | {"integrator": {"type": "path", "max_depth": 3}}
    scene = rt.load_dict(scenes.scene_dict(**things))
    params = rt.traverse(scene)
    for key in params.keys():
        dr.enable_grad(params[key])
    params.update()
    image = rt.render(scene, params, spp=4, seed=1, accel="brute_force", filter="bilinear", footprint_gradients=False)
    dr.backward(dr.sum(image, axis=None))
    wrong = [key for key in params.keys() if not np.isfinite(dr.grad(params[key]).numpy()).all()]
    assert not wrong


def test_gradients_through_footprints_at_a_pole_are_finite() -> None:
    scene = rt.load_dict(scenes.scene_dict(**EXTREMES["pole"](), integrator={"type": "direct"}))
    params = rt.traverse(scene)
    keys = [key for key in params.keys() if "data" in key or "to_world" in key]
    for key in keys:
        dr.enable_grad(params[key])
    params.update()
    image = rt.render(scene, params, spp=4, seed=1, accel="brute_force", filter="ewa")
    dr.backward(dr.sum(image, axis=None))
    wrong = [key for key in keys if not np.isfinite(dr.grad(params[key]).numpy()).all()]
    assert not wrong
