"""Gradients by what decides how often a random choice is made, against differences of the means of many samples."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest
from gradient_grammar import SKY, bitmap, mitsuba, rgb

import raytrace2 as rt

SEEDS = 12
SPP = 256


def scene(bsdf: dict[str, Any], **more: Any) -> rt.Scene:
    """A ball of ``bsdf`` under a smooth sky, and ``more``."""
    T = mitsuba().ScalarTransform4f
    film = {"type": "hdrfilm", "width": 6, "height": 6, "rfilter": {"type": "box"}}
    look = T().look_at([0, -4.0, 1.0], [0, 0, 0], [0, 0, 1])
    return rt.load_dict({
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 6, "rr_depth": 100},
        "sensor": {"type": "perspective", "fov": 20, "to_world": look, "film": film},
        "ball": {"type": "sphere", "bsdf": bsdf},
        "sky": {"type": "envmap", "bitmap": mitsuba().Bitmap(SKY), "to_world": T().rotate([1, 0, 0], 90)},
        **more,
    })  # fmt: skip


MASK = {"type": "mask", "opacity": 0.6, "n": {"type": "diffuse", "reflectance": rgb(0.2, 0.3, 0.1)}}
GLASS = {"type": "dielectric", "specular_transmittance": rgb(0.3, 0.5, 0.4)}
PANE = {"type": "thindielectric", "specular_transmittance": bitmap(np.float32([[[0.3, 0.5, 0.4]]]))}
CASES = {"ball.bsdf.opacity.value": MASK, "ball.bsdf.eta": GLASS, "pane": PANE}


@pytest.mark.parametrize("name", CASES)
def test_choices_are_weighted_by_their_chances(name: str) -> None:
    loaded = scene(CASES[name])
    key = "ball.bsdf.eta" if name == "pane" else name
    params = rt.traverse(loaded, "float64")
    start, step = params[key].numpy(), 0.02
    gradients, differences = [], []
    for seed in range(SEEDS):
        ends = []
        for value in (start - step, start + step):
            params[key] = value
            params.update()
            ends.append(rt.render(loaded, spp=SPP, seed=seed, precision="float64").numpy().sum())
        differences.append((ends[1] - ends[0]) / (2 * step))
        params[key] = start
        dr.enable_grad(params[key])
        image = rt.render(loaded, params, spp=SPP, seed=seed, seed_grad=seed + 1000)
        dr.backward(dr.sum(image, axis=None))
        gradients.append(dr.grad(params[key]).numpy()[0])
    a, b = np.array(gradients), np.array(differences)
    error = np.sqrt((a.var(ddof=1) + b.var(ddof=1)) / SEEDS)
    assert abs(b.mean()) > 10 * error
    assert abs(a.mean() - b.mean()) < 4.5 * error + 2e-3 * abs(b.mean())
