"""A small scene with one parameter of every kind, for tests of gradients."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

import raytrace2 as rt

PIXELS = np.random.default_rng(3).random((7, 6, 3)).astype(np.float32)

#: What is differentiated by, with the filter that the scene is rendered with.
CASES = {
    "texels, bilinear": ("floor.bsdf.reflectance.data", "bilinear"),
    "texels, ewa": ("floor.bsdf.reflectance.data", "ewa"),
    "texels, exact": ("floor.bsdf.reflectance.data", "exact"),
    "colour": ("box.bsdf.reflectance.value", None),
    "alpha": ("ball.bsdf.alpha.value", None),
    "light": ("lamp.intensity.value", None),
    "vertices": ("box.vertex_positions", None),
    "sphere": ("ball.to_world", None),
    "camera": ("sensor.to_world", None),
}


def transforms() -> Any:
    """Mitsuba's transforms."""
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    return mi.ScalarTransform4f


def scene_dict(**things: Any) -> dict[str, Any]:
    """The scene, with ``things`` in place of its own."""
    import mitsuba as mi

    T = transforms()
    image = {"type": "bitmap", "bitmap": mi.Bitmap(PIXELS), "raw": True}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3},
        "sensor": {
            "type": "perspective",
            "fov": 50,
            "to_world": T().look_at([0.3, -3.0, 2.0], [0, 0, 0.3], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": 10, "height": 8, "filter": {"type": "box"}},
        },
        "floor": {
            "type": "rectangle",
            "to_world": T().scale([3, 3, 1]),
            "bsdf": {"type": "diffuse", "reflectance": image},
        },
        "ball": {
            "type": "sphere",
            "to_world": T().translate([0.6, 0, 0.5]).scale(0.5),
            "bsdf": {"type": "roughconductor", "alpha": 0.2, "specular_reflectance": 0.8},
        },
        "box": {
            "type": "cube",
            "to_world": T().translate([-0.7, 0, 0.4]).scale(0.3),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.3, 0.5, 0.4]}},
        },
        "lamp": {"type": "point", "position": [0.5, -1, 3], "intensity": {"type": "rgb", "value": [5, 6, 7]}},
    } | things


def load(**things: Any) -> rt.Scene:
    """The scene, loaded."""
    return rt.load_dict(scene_dict(**things))


class Latent:
    """A parameter of a scene by what an optimiser may move freely: of transforms, where they take the origin."""

    def __init__(self, params: rt.SceneParameters, key: str) -> None:
        self.key = key
        value = params[key]
        self.base = type(value)(value)
        dr.make_opaque(self.base)
        moves = dr.is_matrix_v(self.base)
        self.start = type(self.base[0, 0])(0) if moves else value

    def value(self, latent: Any) -> Any:
        """The parameter's value."""
        if not dr.is_matrix_v(self.base):
            return latent
        size = len(self.base)
        entries = [[self.base[i, j] for j in range(size)] for i in range(size)]
        entries[0][-1] = entries[0][-1] + latent
        return type(self.base)(*(e for row in entries for e in row))
