"""Paths: the same image as Mitsuba from the same random numbers, and closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from render_cases import ball, both, cornell_box, corner, diffuse, lamp, mitsuba, ours, rgb, same_share, scene, texels

import raytrace2 as rt
from raytrace2.rays.differentials.autodiff import Autodiff
from raytrace2.textures.bitmap import Bitmaps


@pytest.mark.parametrize(
    "settings",
    [
        {"max_depth": 0},
        {"max_depth": 1},
        {"max_depth": 2},
        {"max_depth": 3},
        {"max_depth": 8},
        {"max_depth": -1, "rr_depth": 1},
        {"max_depth": 2, "hide_emitters": True},
        {"max_depth": 4, "hide_emitters": True},
    ],
    ids=str,
)
def test_cornell_box_equals_mitsubas(settings: dict[str, Any]) -> None:
    a, b = both(cornell_box(**settings))
    # Rounding decides now and then which way a path goes on; the longer, the oftener.
    assert same_share(a, b) >= (0.995 if 0 <= settings["max_depth"] <= 3 else 0.93)
    np.testing.assert_allclose(a.mean(), b.mean(), rtol=1e-3)


MATERIALS: dict[str, Any] = {
    "conductor": {"type": "conductor", "material": "Au"},
    "mirror": {"type": "conductor", "material": "none", "specular_reflectance": rgb(0.9, 0.8, 0.7)},
    "dielectric": {"type": "dielectric", "int_ior": 1.8, "specular_transmittance": rgb(0.9, 0.5, 0.3)},
    "thindielectric": {"type": "thindielectric"},
    "twosided": {"type": "twosided", "front": diffuse(0.8, 0.2, 0.2), "back": {"type": "conductor"}},
    "mask": {"type": "mask", "opacity": 0.4, "inside": diffuse(0.8, 0.2, 0.2)},
    "mask of a mirror": {"type": "mask", "opacity": 0.4, "inside": {"type": "conductor"}},
}


def texture(kind: str) -> dict[str, Any]:
    mi = mitsuba()
    to_uv = mi.ScalarTransform4f().scale([4, 3, 1])
    if kind == "checkerboard":
        return {"type": "checkerboard", "to_uv": to_uv}
    return {"type": "bitmap", "bitmap": mi.Bitmap(texels()), "raw": True, "to_uv": to_uv, "filter_type": kind}


def check(a: np.ndarray, b: np.ndarray) -> None:
    assert np.isfinite(a).all()
    assert same_share(a, b) >= 0.93
    np.testing.assert_allclose(a.mean(axis=(0, 1)), b.mean(axis=(0, 1)), rtol=2e-3)


@pytest.mark.parametrize("name", MATERIALS)
def test_materials_equal_mitsubas(name: str) -> None:
    check(*both(scene(**corner(lamp=lamp(), ball=ball(MATERIALS[name])))))


@pytest.mark.parametrize("name", ["checkerboard", "nearest", "bilinear"])
def test_textures_equal_mitsubas(name: str) -> None:
    check(*both(scene(**corner(lamp=lamp(), ball=ball({"type": "diffuse", "reflectance": texture(name)})))))


@pytest.mark.parametrize("wrapped", ["bare", "twosided"])
@pytest.mark.parametrize("name", ["trilinear", "ewa", "exact"])
def test_a_bounce_looks_up_a_texture_once(name: str, wrapped: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Though the material is evaluated for a light and sampled for the way on."""
    calls = {"meet": 0, "_look_up": 0}

    def count(owner: type, what: str) -> None:
        method = getattr(owner, what)

        def counted(*arguments: Any) -> Any:
            calls[what] += 1
            return method(*arguments)

        monkeypatch.setattr(owner, what, counted)

    bsdf = {"type": "diffuse", "reflectance": texture("bilinear")}
    things = corner(lamp=lamp(), ball=ball(bsdf if wrapped == "bare" else {"type": "twosided", "bsdf": bsdf}))
    loaded = rt.load_dict(scene(mirror=ball({"type": "conductor"}), **things))
    count(Autodiff, "meet")
    count(Bitmaps, "_look_up")
    rt.render(loaded, spp=1, filter=name, size=(4, 4))
    assert calls["_look_up"] == calls["meet"] > 0


def test_a_textured_mask_equals_mitsubas() -> None:
    bsdf = {"type": "mask", "opacity": texture("checkerboard"), "inside": diffuse(0.8, 0.2, 0.2)}
    check(*both(scene(**corner(lamp=lamp(), ball=ball(bsdf)))))


def test_instances_equal_mitsubas() -> None:
    T = mitsuba().ScalarTransform4f
    group = {"type": "shapegroup", "a": ball(diffuse(0.8, 0.3, 0.2)), "b": {"type": "cube", "to_world": T().scale(0.6)}}

    def instance(to_world: Any) -> dict[str, Any]:
        return {"type": "instance", "group": {"type": "ref", "id": "group"}, "to_world": to_world}

    left = instance(T().translate([-0.8, 0, 0]).scale(0.6))
    right = instance(T().translate([0.8, 0, 0]).rotate([0, 0, 1], 40).scale(0.5))
    check(*both(scene(**corner(lamp=lamp(), group=group, left=left, right=right))))


@pytest.mark.parametrize("name", ["dielectric", "thindielectric", "mask"])
def test_hidden_emitters_are_hidden_behind_what_is_passed_through_too(name: str) -> None:
    integrator = {"type": "path", "hide_emitters": True}
    things = corner(ball=ball(MATERIALS[name]))
    del things["wall"]
    check(*both(scene(integrator=integrator, light={"type": "constant"}, **things)))


@pytest.mark.parametrize("shape", ["sphere", "cube"])
def test_a_grey_furnace_glows_as_the_geometric_series_says(shape: str) -> None:
    """In a closed body that shines with 1 everywhere and reflects half, radiance after k segments is 2 - 2^(1-k)."""
    wall = {"type": shape, "bsdf": diffuse(0.5), "emitter": {"type": "area", "radiance": 1.0}, "flip_normals": True}
    wall["to_world"] = mitsuba().ScalarTransform4f().scale(8)
    for depth, expected in ((1, 1.0), (2, 1.5), (4, 1.875), (-1, 2.0)):
        image = ours(scene(integrator={"type": "path", "max_depth": depth, "rr_depth": 3}, wall=wall), spp=64)
        error = image.std() / np.sqrt(image.shape[0] * image.shape[1])
        assert abs(image.mean() - expected) <= 4 * error + 1e-3, depth


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_a_white_ball_vanishes_in_a_white_sky(precision: str) -> None:
    """White furnace: a convex body that reflects everything looks like the sky around it; by half, like half of it."""
    sky = {"type": "constant", "radiance": 1.0}
    white = ours(scene(sky=sky, ball=ball(diffuse(1.0))), spp=256, precision=precision)
    grey = ours(scene(sky=sky, ball=ball(diffuse(0.5))), spp=256, precision=precision)
    middle = (slice(10, 14), slice(10, 14))
    for image, expected in ((white, 1.0), (grey[middle], 0.5)):
        assert abs(image.mean() - expected) <= 4 * image.std() / np.sqrt(image[..., 0].size) + 1e-5
    glass = ours(scene(sky=sky, ball=ball({"type": "dielectric"})), spp=64, precision=precision)
    np.testing.assert_allclose(glass.mean(), 1.0, atol=0.02)
