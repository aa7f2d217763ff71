"""Gradients by the vertices of a light: its triangles are chosen by their areas, which change."""

from __future__ import annotations

from pathlib import Path

import drjit as dr
import numpy as np
from gradient_grammar import mitsuba, rgb

import raytrace2 as rt

SEEDS = 8
SPP = 1024


def scene(folder: Path) -> rt.Scene:
    """A rough floor close below a square light of four triangles about a vertex, which the camera does not see."""
    T = mitsuba().ScalarTransform4f
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1), (0.3, -0.2)]
    rows = [f"v {x} {y} 0" for x, y in corners] + [f"f {a} {a % 4 + 1} 5" for a in (1, 2, 3, 4)]
    (folder / "light.obj").write_text("\n".join(rows) + "\n")
    film = {"type": "hdrfilm", "width": 6, "height": 6, "rfilter": {"type": "box"}}
    look = T().look_at([0, -3.0, 0.4], [0, 0, 0], [0, 0, 1])
    lamp = {"type": "area", "radiance": rgb(3, 2, 1)}
    metal = {"type": "roughconductor", "alpha": 0.35}
    return rt.load_dict({
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2},
        "sensor": {"type": "perspective", "fov": 12, "to_world": look, "film": film},
        "floor": {"type": "rectangle", "to_world": T().scale([3, 3, 1]), "bsdf": metal},
        "light": {
            "type": "obj", "filename": str(folder / "light.obj"), "face_normals": True, "emitter": lamp,
            "to_world": T().translate([0, 0.3, 1]).rotate([1, 0, 0], 180),
        },
    })  # fmt: skip


def test_a_vertex_within_a_flat_light_changes_nothing(tmp_path: Path) -> None:
    loaded = scene(tmp_path)
    params = rt.traverse(loaded, "float64")
    key = "light.vertex_positions"
    dr.enable_grad(params[key])
    params.update()
    middle = np.argmin(np.abs(params[key].numpy().reshape(-1, 3)[:, 0] - 0.3))
    image = rt.render(loaded, spp=SPP, precision="float64").numpy().sum()
    assert image > 0
    found = []
    for seed in range(SEEDS):
        dr.set_grad(params[key], 0)
        dr.backward(dr.sum(rt.render(loaded, params, spp=SPP, seed=seed), axis=None))
        found.append(dr.grad(params[key]).numpy().reshape(-1, 3)[middle, :2])
    error = np.std(found, axis=0, ddof=1) / np.sqrt(SEEDS)
    assert (error < 5e-3 * image).all()
    assert (np.abs(np.mean(found, axis=0)) < 4 * error).all()
