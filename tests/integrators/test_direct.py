"""Direct light: the same image as Mitsuba from the same random numbers, every kind of light, and closed forms."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest
from render_cases import (
    ball,
    both,
    camera,
    cornell_box,
    corner,
    diffuse,
    lamp,
    mitsuba,
    ours,
    rgb,
    same_share,
    scene,
    texels,
)

import raytrace2 as rt
from raytrace2.integrators.emission import power_heuristic
from raytrace2.types import types


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"hide_emitters": True},
        {"emitter_samples": 3, "bsdf_samples": 2},
        {"emitter_samples": 0, "bsdf_samples": 1},
        {"emitter_samples": 1, "bsdf_samples": 0},
    ],
    ids=str,
)
def test_cornell_box_equals_mitsubas(settings: dict[str, Any]) -> None:
    box = cornell_box()
    box["integrator"] = {"type": "direct", **settings}
    a, b = both(box)
    assert same_share(a, b) >= 0.99


def lights() -> dict[str, Any]:
    mi = mitsuba()
    T = mi.ScalarTransform4f
    area = {"type": "area", "radiance": 4.0}
    down = T().translate([0, 1.8, 0]).rotate([1, 0, 0], 90)
    image = {"type": "bitmap", "bitmap": mi.Bitmap(texels()), "raw": True}
    spot = T().look_at(origin=[1, 2, 2], target=[0, 0, 0], up=[0, 1, 0])
    return {
        "point": {"type": "point", "position": [1, 1.5, 1], "intensity": rgb(3, 2, 1)},
        "spot": {"type": "spot", "to_world": spot, "intensity": 8.0, "cutoff_angle": 35.0},
        "directional": {"type": "directional", "direction": [-1, -1, -1], "irradiance": rgb(3, 2, 1)},
        "constant": {"type": "constant", "radiance": 0.5},
        "rectangle": lamp(4, 3, 2),
        "disk": {"type": "disk", "to_world": down.scale(0.5), "emitter": area},
        "cylinder": {"type": "cylinder", "p0": [-1, 1, 0], "p1": [1, 1, 0], "radius": 0.2, "emitter": area},
        "mesh": {"type": "cube", "to_world": T().translate([0, 1.5, 0]).scale(0.2), "emitter": area},
        # These are sampled in other ways than Mitsuba samples them.
        "sphere": {"type": "sphere", "center": [1, 1, 0], "radius": 0.3, "emitter": area},
        "envmap": {"type": "envmap", "bitmap": mi.Bitmap(texels()), "to_world": T().rotate([0, 1, 0], 30)},
        "textured": {**lamp(), "emitter": {"type": "area", "radiance": image}},
    }


@pytest.mark.parametrize("name", ["point", "spot", "directional", "constant", "rectangle", "disk", "cylinder", "mesh"])
def test_lights_equal_mitsubas(name: str) -> None:
    a, b = both(scene(integrator={"type": "direct"}, **corner(light=lights()[name], ball=ball())))
    assert np.isfinite(a).all()
    # Near its cutoff a spot is the small difference of two angles, in which rounding shows.
    assert same_share(a, b) >= (0.85 if name == "spot" else 0.97)
    np.testing.assert_allclose(a.mean(axis=(0, 1)), b.mean(axis=(0, 1)), rtol=1e-3)


@pytest.mark.parametrize("name", ["sphere", "envmap", "textured", "all"])
def test_lights_equal_mitsubas_but_for_noise(name: str, tmp_path: Path) -> None:
    every = lights()
    chosen = {k: every[k] for k in ("point", "spot", "directional", "sphere", "envmap", "rectangle")}
    if name != "all":
        chosen = {name: every[name]}
    found = rt.compare(
        rt.load_dict(scene(integrator={"type": "direct"}, **corner(ball=ball(), **chosen))),
        spp=128, cache_dir=tmp_path, progress=False,
    )  # fmt: skip
    assert found.consistent, found.noise.reasons


def floor(bsdf: dict[str, Any]) -> dict[str, Any]:
    """Fills the view of a camera that looks along -z."""
    T = mitsuba().ScalarTransform4f
    return {"type": "rectangle", "to_world": T().translate([0, 0, -1]).scale(20), "bsdf": bsdf}


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_a_point_light_falls_off_with_cosine_over_squared_distance(precision: str) -> None:
    light = {"type": "point", "position": [0.5, 0.25, 1], "intensity": rgb(3, 2, 1)}
    aovs = {"type": "aov", "aovs": "p:position", "image": {"type": "direct"}}
    source = scene(integrator=aovs, light=light, floor=floor(diffuse(0.8)))
    image = ours(source, spp=1, precision=precision).astype(np.float64)
    to_light = np.array([0.5, 0.25, 1]) - image[..., 3:6]
    distance = np.linalg.norm(to_light, axis=2)
    expected = 0.8 / np.pi * (to_light[..., 2] / distance**3)[..., None] * [3, 2, 1]
    np.testing.assert_allclose(image[..., :3], expected, rtol=3e-6 if precision == "float32" else 1e-6)


def test_a_shining_sphere_lights_a_plane_as_if_it_were_a_point() -> None:
    """Irradiance pi L (r / d)^2 cos at points that see all of the sphere, whatever its size."""
    sphere = {"type": "sphere", "center": [0.5, 0.25, 1], "radius": 1.2, "emitter": {"type": "area", "radiance": 2.0}}
    aovs = {"type": "aov", "aovs": "p:position", "image": {"type": "direct", "hide_emitters": True}}
    spp = 256
    source = scene(integrator=aovs, sensor=camera((16, 16)), light=sphere, floor=floor(diffuse(0.8)))
    image = ours(source, spp=spp)
    # aovs see the sphere itself, so the places on the plane are those of a scene without it.
    source = scene(integrator=aovs, sensor=camera((16, 16)), floor=floor(diffuse(0.8)))
    to_light = np.array([0.5, 0.25, 1]) - ours(source, spp=spp)[..., 3:6]
    distance = np.linalg.norm(to_light, axis=2)
    expected = 0.8 * 2.0 * (1.2 / distance) ** 2 * to_light[..., 2] / distance
    error = image[..., 0] / expected - 1
    assert abs(error.mean()) <= 4 * error.std() / np.sqrt(error.size) + 1e-3
    assert np.abs(error).max() < 0.1


def test_weights_add_up_and_survive_extreme_densities() -> None:
    for precision in ("float32", "float64"):
        Float = types(precision).Float
        a = Float([1, 3, 1e30, 1e-30, 1e30, 0, 1, 1e38])
        b = Float([1, 1, 1e30, 1e-30, 1e-30, 1, 0, 1])
        w = np.array(power_heuristic(a, b))
        np.testing.assert_allclose(w, [0.5, 0.9, 0.5, 0.5, 1, 0, 1, 1], rtol=1e-6)
        np.testing.assert_allclose(w + np.array(power_heuristic(b, a)), 1, rtol=1e-6)
        assert np.array(power_heuristic(Float(np.inf), Float(1)))[0] == 1
        assert dr.all(power_heuristic(Float(0), Float(0)) == 0)


def test_a_small_far_light_is_worth_what_its_area_says() -> None:
    """A millionth across and a thousand away, densities squared are past float32."""
    T = mitsuba().ScalarTransform4f
    small = T().translate([0, 0, 1000]).rotate([1, 0, 0], 180).scale(1e-6)
    light = {"type": "rectangle", "to_world": small, "emitter": {"type": "area", "radiance": 1e18}}
    image = ours(scene(integrator={"type": "direct"}, light=light, floor=floor(diffuse(0.8))), spp=4)
    expected = 0.8 / np.pi * 1e18 * 4e-12 / 1001**2
    np.testing.assert_allclose(image[8:16, 8:16], expected, rtol=1e-3)


@pytest.mark.skipif("RAYTRACE2_MITSUBA_DATA" not in os.environ, reason="RAYTRACE2_MITSUBA_DATA is not set")
@pytest.mark.parametrize("name", ["emitter_spot_no_texture", "shape_rectangle", "bsdf_mask_after"])
def test_documentation_scenes_equal_mitsubas_but_for_noise(name: str, tmp_path: Path) -> None:
    file = Path(os.environ["RAYTRACE2_MITSUBA_DATA"]) / "docs" / "scenes" / f"{name}.xml"
    found = rt.compare(rt.load_file(file, spp=1), spp=16, size=(48, 36), cache_dir=tmp_path, progress=False)
    assert found.consistent, found.noise.reasons
