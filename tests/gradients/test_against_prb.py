"""Gradients of a fixed linear function of the image against those of Mitsuba's ``prb``, within the noise of both.

Only what ``prb`` has without bias: it detaches sampling, and has no derivatives of mirrors, glass and masks. Directions
that a rough metal reflects to move with its roughness here, past edges of what they meet: such metals stand alone
under a sky.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest
from gradient_grammar import COLOR, GREY, NORMALS, SKY, bitmap, mitsuba, rgb
from scipy.stats import t as student

import raytrace2 as rt

SEEDS = 16
SPP = 32
#: Along so many random directions gradients with more components are compared.
DIRECTIONS = 12


def base(**things: Any) -> dict[str, Any]:
    """A camera over a textured floor, and ``things``."""
    T = mitsuba().ScalarTransform4f
    film = {"type": "hdrfilm", "width": 12, "height": 10, "rfilter": {"type": "box"}}
    look = T().look_at([0.3, -4.0, 3.0], [0, 0, 0.3], [0, 0, 1])
    floor = {"type": "diffuse", "reflectance": bitmap(COLOR)}
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 4, "rr_depth": 100},
        "sensor": {"type": "perspective", "fov": 45, "to_world": look, "film": film},
        "floor": {"type": "rectangle", "to_world": T().scale(3), "bsdf": floor},
    } | things


def room() -> dict[str, Any]:
    """Light between diffuse things, of lamps of every kind."""
    T = mitsuba().ScalarTransform4f
    spot = T().look_at([1, -1.5, 4], [0, 0.2, 0], [0, 1, 0])
    plain = {"type": "diffuse", "reflectance": rgb(0.5, 0.4, 0.3)}
    back = {"type": "diffuse", "reflectance": {"type": "checkerboard", "color0": rgb(0.2, 0.3, 0.4)}}
    panel = T().translate([-1, 0, 2.5]).rotate([0, 1, 0], 160).scale(0.5)
    return base(
        box={"type": "cube", "to_world": T().translate([0.6, 0, 0.5]).scale(0.4), "bsdf": plain},
        ball={"type": "sphere", "center": [-0.7, 0.2, 0.5], "radius": 0.5, "bsdf": {"type": "twosided", "b": back}},
        lamp={"type": "point", "position": [0.5, -1, 3], "intensity": rgb(5, 6, 7)},
        panel={"type": "rectangle", "to_world": panel, "emitter": {"type": "area", "radiance": rgb(4, 5, 6)}},
        spot={"type": "spot", "intensity": rgb(30, 25, 20), "to_world": spot, "texture": bitmap(COLOR)},
        sun={"type": "directional", "direction": [0.3, 0.4, -1], "irradiance": rgb(2, 1.5, 1)},
        sky={"type": "constant", "radiance": rgb(0.5, 0.7, 0.9)},
    )


def metals() -> dict[str, Any]:
    """Rough metals under an image of the sky, which see nothing else."""
    T = mitsuba().ScalarTransform4f
    half_bright = SKY * (1 + 5 * (np.arange(SKY.shape[1]) < 4))[None, :, None].astype(np.float32)
    index = {"eta": rgb(1.2, 1.0, 0.8), "k": rgb(6, 5, 4), "specular_reflectance": rgb(0.8, 0.9, 0.7)}
    even = {"type": "roughconductor", "alpha": bitmap(GREY), **index}
    uneven = {"type": "roughconductor", "distribution": "ggx", "alpha_u": 0.2, "alpha_v": 0.4, **index}
    bent = {"type": "normalmap", "normalmap": bitmap(NORMALS), "n": {"type": "diffuse", "reflectance": 0.6}}
    found = base(
        left={"type": "rectangle", "to_world": T().translate([-2, 0, 0]), "bsdf": even},
        right={"type": "rectangle", "to_world": T().translate([2, 0, 0]), "bsdf": uneven},
        middle={"type": "rectangle", "to_world": T().translate([0, 1.5, 0]).scale(0.8), "bsdf": bent},
        sky={"type": "envmap", "bitmap": mitsuba().Bitmap(half_bright), "scale": 1.5},
    )
    del found["floor"]
    return found


SCENES = {
    "room": (
        room,
        ["floor.bsdf.reflectance.data", "box.bsdf.reflectance.value", "ball.bsdf.brdf_0.reflectance.color0.value"],
        ["lamp.intensity.value", "panel.emitter.radiance.value", "spot.intensity.value", "spot.texture.data"],
        ["sun.irradiance.value", "sky.radiance.value"],
    ),
    "metals": (
        metals,
        ["left.bsdf.alpha.data", "right.bsdf.alpha_u.value", "right.bsdf.alpha_v.value", "left.bsdf.eta.value"],
        ["left.bsdf.k.value", "right.bsdf.specular_reflectance.value", "sky.data", "sky.scale"],
        ["middle.bsdf.normalmap.data", "middle.bsdf.nested_bsdf.reflectance.value"],
    ),
}


def gradients(scene: Any, params: Any, render: Any, keys: list[str]) -> dict[str, np.ndarray]:
    """Of every seed a row."""
    rows: dict[str, list[np.ndarray]] = {key: [] for key in keys}
    weights = None
    for seed in range(SEEDS):
        for key in keys:
            dr.enable_grad(params[key])
            dr.set_grad(params[key], 0)
        params.update()
        image = render(scene, params, spp=SPP, seed=seed + 1)
        if weights is None:
            weights = type(image)(np.random.default_rng(5).random(image.shape).astype(np.float32))
        dr.backward(dr.sum(image * weights, axis=None))
        for key in keys:
            rows[key].append(folded(key, np.array(dr.grad(params[key]))).ravel())
    return {key: np.array(found, np.float64) for key, found in rows.items()}


def folded(key: str, gradient: np.ndarray) -> np.ndarray:
    """That of a sky without its columns beside the image, which Mitsuba reads, and which follow those within."""
    if key != "sky.data":
        return gradient
    found = gradient[:, 1:-1].copy()
    found[:, -1] += gradient[:, 0]
    found[:, 0] += gradient[:, -1]
    return found


@pytest.mark.parametrize("name", SCENES)
def test_gradients_agree_within_noise(name: str) -> None:
    mi = mitsuba()
    make, *parts = SCENES[name]
    keys = [key for part in parts for key in part]
    described = make()
    scene = rt.load_dict(described | {"integrator": {**described["integrator"], "type": "path"}})
    reference = mi.load_dict(described)
    ours = gradients(scene, rt.traverse(scene), rt.render, keys)
    theirs = gradients(reference, mi.traverse(reference), mi.render, keys)
    rng = np.random.default_rng(3)
    chances = {}
    for key in keys:
        a, b = ours[key], theirs[key]
        assert a.shape == b.shape, key
        if a.shape[1] > DIRECTIONS:
            directions = np.column_stack([np.ones(a.shape[1]), rng.normal(size=(a.shape[1], DIRECTIONS - 1))])
            a, b = a @ directions, b @ directions
        error = np.sqrt(a.var(0, ddof=1) / SEEDS + b.var(0, ddof=1) / SEEDS) + 1e-6 * np.abs(b).max()
        z = (a.mean(0) - b.mean(0)) / error
        # A test that sees nothing is none.
        assert np.abs(b.mean(0) / error).max() > 5, key
        chances[key] = min(1.0, 2 * student.sf(np.abs(z).max(), SEEDS - 1) * len(z))
    assert min(chances.values()) > 1e-3 / len(keys), chances
