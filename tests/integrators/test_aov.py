"""Aovs: Mitsuba's values at the same samples, names, misses, and footprints."""

from __future__ import annotations

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
    same_share,
    scene,
    texels,
)

import raytrace2 as rt
from raytrace2.integrators.aov import CHANNELS
from raytrace2.render import render_detailed
from raytrace2.scene.description import Integrator
from raytrace2.scene.read_integrators import AOV_KINDS

KINDS = "albedo depth position uv geo_normal sh_normal dp_du dp_dv duv_dx duv_dy prim_index shape_index".split()


def aov(*kinds: str, **more: Any) -> dict[str, Any]:
    return {"type": "aov", "aovs": ",".join(f"{kind}:{kind}" for kind in kinds), **more}


def variety() -> dict[str, Any]:
    T = mitsuba().ScalarTransform4f
    image = {"type": "bitmap", "bitmap": mitsuba().Bitmap(texels()), "raw": True}
    return corner(
        ball=ball({"type": "diffuse", "reflectance": image}, center=[-0.9, 0, 0]),
        cube={"type": "cube", "to_world": T().translate([1, 0, 0]).rotate([0, 1, 0], 30).scale(0.5)},
        tube={"type": "cylinder", "p0": [0, -1, 0], "p1": [0, 1, 0.5], "radius": 0.3, "bsdf": diffuse(0.3)},
        disk={"type": "disk", "to_world": T().translate([0.5, -0.6, 1]).scale(0.3)},
    )


@pytest.mark.parametrize(
    ("kind", "tolerance"),
    [("albedo", 1e-4), ("depth", 2e-6), ("position", 5e-6), ("uv", 1e-5), ("geo_normal", 1e-5), ("sh_normal", 1e-5),
     ("dp_du", 2e-5), ("dp_dv", 2e-5)],
)  # fmt: skip
def test_values_are_mitsubas_at_the_same_samples(kind: str, tolerance: float, values: tuple[Any, Any]) -> None:
    a, b = (v[kind] for v in values)
    np.testing.assert_array_equal((values[0]["depth"] > 0), (values[1]["depth"] > 0))
    error = np.abs(a - b).max(axis=-1) / max(1.0, np.abs(b).max())
    assert np.median(error) < 1e-6
    # A bitmap's edges, a seam, a pole may fall anywhere.
    assert np.quantile(error, 0.99) < tolerance


@pytest.fixture(scope="module")
def values() -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Per kind: our values and Mitsuba's, one sample a pixel."""
    kinds = KINDS[:-4]
    images = both(scene(integrator=aov(*kinds), sensor=camera((48, 40)), **variety()), spp=1)
    widths = [1 if kind == "depth" else 2 if kind == "uv" else 3 for kind in kinds]
    # Mitsuba puts a black colour and its own alpha, or none, before the aovs.
    found = []
    for image in images:
        parts = np.split(image[..., image.shape[2] - sum(widths) :], np.cumsum(widths)[:-1], axis=2)
        found.append(dict(zip(kinds, parts, strict=True)))
    return found[0], found[1]


def test_channels_are_named_and_follow_the_colour() -> None:
    box = cornell_box(16, max_depth=2)
    box["integrator"] = aov("depth", "uv", image=box["integrator"])
    done = render_detailed(rt.load_dict(box), spp=4)
    assert done.channels == ["R", "G", "B", "depth.T", "uv.U", "uv.V"]
    assert done.image.shape == (16, 16, 6)
    a, b = both(box, spp=4)
    assert same_share(a, b[..., -6:]) > 0.95
    plain = ours(cornell_box(16, max_depth=2), spp=4)
    np.testing.assert_array_equal(a[..., :3], plain)


def test_shapes_are_counted_from_one_in_the_scenes_order_and_misses_are_zero() -> None:
    T = mitsuba().ScalarTransform4f
    group = {"type": "shapegroup", "a": {"type": "rectangle"}}
    ref = {"type": "ref", "id": "group"}
    source = scene(
        integrator=aov("shape_index", "prim_index", "depth"), sensor=camera((40, 8)),
        left=ball(center=[-1.6, 0, 0], radius=0.3), group=group,
        middle={"type": "instance", "g": ref, "to_world": T().scale(0.3)},
        right={"type": "instance", "g": ref, "to_world": T().translate([1.6, 0, 0]).scale(0.3)},
    )  # fmt: skip
    image = ours(source, spp=1)
    row = image[4, :, 0]
    seen = [int(v) for k, v in enumerate(row) if v and (k == 0 or row[k - 1] != v)]
    assert seen == [1, 2, 3]
    assert (image[image[..., 2] == 0] == 0).all()


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_footprints_equal_the_difference_between_neighbouring_pixels(precision: str) -> None:
    """On a plane seen by a camera without perspective, uv is linear in the pixel: a step of one pixel is duv_dx."""
    T = mitsuba().ScalarTransform4f
    tilted = T().rotate([0, 1, 0], 50).rotate([1, 0, 0], 20).scale(9)
    source = scene(
        integrator=aov("uv", "duv_dx", "duv_dy"), sensor=camera((20, 12), kind="orthographic"),
        plane={"type": "rectangle", "to_world": tilted},
    )  # fmt: skip
    image = ours(source, spp=1, precision=precision)
    again = ours({**source, "sensor": camera((40, 24), kind="orthographic")}, spp=1, precision=precision)
    dx, dy = image[..., 2:4], image[..., 4:6]
    assert np.ptp(dx, axis=(0, 1)).max() < 1e-6 and np.ptp(dy, axis=(0, 1)).max() < 1e-6
    np.testing.assert_allclose(again[0, 0, 2:] * 2, image[0, 0, 2:], rtol=1e-4, atol=1e-7)
    # Over the whole film the steps add up to what uv spans.
    corner_to_corner = image[-1, -1, :2] - image[0, 0, :2]
    steps = 19 * dx[0, 0] + 11 * dy[0, 0]
    assert np.abs(corner_to_corner - steps).max() <= 1.01 * (np.abs(dx[0, 0]) + np.abs(dy[0, 0])).max()


def test_footprints_shrink_with_the_samples_and_equal_mitsubas() -> None:
    """With the thin lens: the neighbours of a perspective camera's rays start off the near plane in Mitsuba."""
    lens = camera((24, 20), kind="thinlens", aperture_radius=0.1, focus_distance=5.0)
    source = scene(integrator=aov("duv_dx", "duv_dy"), sensor=lens, **corner())
    # For more samples Mitsuba shrinks the step along the chord of the directions, which differs to second order.
    for spp, tolerance in ((1, 1e-3), (4, 1e-2)):
        a, b = both(source, spp=spp)
        b = b[..., -4:]
        assert np.median(np.abs(a - b).max(axis=2) / np.abs(b).max(axis=2)) < tolerance
    assert np.median(ours(source, spp=1)[..., 0] / ours(source, spp=4)[..., 0]) == pytest.approx(2, rel=1e-2)


def test_geometry_alone_needs_no_materials() -> None:
    loaded = rt.load_dict(scene(integrator=aov("depth", "sh_normal"), **corner(lamp=lamp())))
    rt.render(loaded, spp=1)
    assert "_tables" not in vars(loaded.traced())


def test_what_rays_cost_is_a_channel_and_costs_nothing_elsewhere() -> None:
    one = rt.load_dict(scene(ball={"type": "sphere"}))
    settings = Integrator("aov", aovs=(("n", "accel.primitives"), ("d", "depth")))
    image = np.array(rt.render(one, integrator=settings, accel="brute_force"))
    assert (image[..., 0] == 1).all(), "brute force tests the one primitive on every ray, misses included"
    assert (image[..., 1] == 0).any() and (image[..., 1] > 0).any()

    def operations(*aovs: tuple[str, str]) -> int:
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            rt.render(one, integrator=Integrator("aov", aovs=aovs))
            return max(k["operation_count"] for k in dr.kernel_history([dr.KernelType.JIT]))

    assert operations(("d", "depth")) < operations(("n", "accel.nodes"), ("d", "depth"))


def test_albedo_is_filtered_by_chance_where_texels_are_drawn() -> None:
    loaded = rt.load_dict(scene(sensor=camera((24, 20)), **variety()))
    settings = Integrator("aov", aovs=(("albedo", "albedo"),))
    drawn = np.array(rt.render(loaded, integrator=settings, filter="stochastic:of=trilinear", spp=256))
    whole = np.array(rt.render(loaded, integrator=settings, filter="trilinear", spp=256))
    assert np.abs(drawn - whole).max() < 0.1
    assert np.abs(drawn - whole).mean() < 5e-3


def test_aovs_alone_are_no_colours() -> None:
    """Of a film for luminance only those are converted that are colours."""
    sensor = camera((24, 20))
    grey = {**sensor, "film": {**sensor["film"], "pixel_format": "luminance"}}
    settings = Integrator("aov", aovs=(("position", "position"), ("depth", "depth")))
    images = [render_detailed(rt.load_dict(scene(sensor=s, **corner())), integrator=settings) for s in (sensor, grey)]
    np.testing.assert_array_equal(*(done.image.numpy() for done in images))
    assert images[0].channels == images[1].channels


def test_aovs_by_name() -> None:
    loaded = rt.load_dict(scene(sensor=camera((12, 10)), **corner()))
    done = render_detailed(loaded, integrator="aov:depth,n:sh_normal")
    assert done.channels == ["depth.T", "n.X", "n.Y", "n.Z"]
    settings = Integrator("aov", aovs=(("depth", "depth"), ("n", "sh_normal")))
    np.testing.assert_array_equal(done.image.numpy(), rt.render(loaded, integrator=settings).numpy())
    for wrong in ("aov", "aov:", "aov:dept", "aov:z:dept"):
        with pytest.raises(rt.SettingError, match="kinds are: albedo, depth"):
            rt.render(loaded, integrator=wrong)
    for wrong in ("aov:depth,depth", "aov:n:position,n:sh_normal", "aov::depth"):
        with pytest.raises(rt.SettingError, match="names that differ"):
            rt.render(loaded, integrator=wrong)
    for pairs in ((), (("a", "dept"),), (("a", "depth"), ("a", "depth"))):
        with pytest.raises(rt.SettingError, match="kinds are: albedo, depth|names that differ"):
            rt.render(loaded, integrator=Integrator("aov", aovs=pairs))


def test_scenes_may_ask_for_every_kind() -> None:
    assert AOV_KINDS == tuple(CHANNELS)


def test_integrators_that_there_are_not_are_refused() -> None:
    scene = rt.load_dict({"type": "scene", "camera": {"type": "perspective"}, "ball": {"type": "sphere"}})
    depth = (("depth", "depth"),)
    unknown: Any = Integrator("photons")  # type: ignore[arg-type]
    for integrator in (unknown, Integrator("aov", aovs=depth, nested=Integrator("aov", aovs=depth))):
        with pytest.raises(rt.SettingError, match="finds light: there are path, direct"):
            rt.render(scene, integrator=integrator)
