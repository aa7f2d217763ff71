"""Renders: cameras, films and samplers as Mitsuba's, scenes that hold next to nothing, passes, and what is compiled."""

from __future__ import annotations

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
    same_share,
    scene,
    texels,
)

import raytrace2 as rt
from raytrace2.film import Film
from raytrace2.render import render_detailed
from raytrace2.scene.description import Integrator

CROP = {"crop_offset_x": 7, "crop_offset_y": 11, "crop_width": 20, "crop_height": 13}
CAMERAS: dict[str, dict[str, Any]] = {
    "thin lens": {"kind": "thinlens", "aperture_radius": 0.2, "focus_distance": 5.0},
    "orthographic": {"kind": "orthographic", "scale": 2.0},
    "wide": {"size": (40, 16)},
    "tall, larger axis": {"size": (12, 30), "fov_axis": "larger"},
    "diagonal axis": {"size": (30, 20), "fov_axis": "diagonal"},
    "principal point": {"principal_point_offset_x": 0.1, "principal_point_offset_y": -0.2},
    "crop": {"size": (40, 32), "film": CROP},
    "orthographic crop": {"size": (40, 32), "kind": "orthographic", "scale": 2.0, "film": CROP},
    "clip planes": {"near_clip": 4.5, "far_clip": 6.0},
    "luminance": {"film": {"pixel_format": "luminance"}},
    "border": {"film": {"sample_border": True, "rfilter": {"type": "gaussian"}}},
}


def room(**settings: Any) -> dict[str, Any]:
    return scene(sensor=camera(**settings), **corner(lamp=lamp(), ball=ball()))


def check(source: dict[str, Any], least: float = 0.93) -> None:
    a, b = both(source)
    assert same_share(a, b) >= least
    np.testing.assert_allclose(a.mean(), b.mean(), rtol=1e-3)


@pytest.mark.parametrize("name", CAMERAS)
def test_cameras_and_films_equal_mitsubas(name: str) -> None:
    check(room(**CAMERAS[name]))


@pytest.mark.parametrize("name", ["tent", "gaussian", "mitchell", "catmullrom", "lanczos"])
def test_reconstruction_filters_equal_mitsubas(name: str) -> None:
    # One path that goes another way is seen in every pixel that its filter reaches.
    check(room(film={"rfilter": {"type": name}}), least=0.85)


@pytest.mark.parametrize("name", ["stratified", "multijitter"])
def test_samplers_equal_mitsubas(name: str) -> None:
    check(room(sampler={"type": name, "sample_count": 16}))


def test_the_low_discrepancy_sampler_converges_to_the_same_image() -> None:
    a, b = (ours(room(sampler={"type": kind}), spp=256) for kind in ("ldsampler", "independent"))
    np.testing.assert_allclose(a.mean(), b.mean(), rtol=5e-3)
    assert np.abs(a - b).mean() < 0.05 * b.mean()


# --- scenes of next to nothing --------------------------------------------------------------------------------------


def test_one_pixel() -> None:
    check(room(size=(1, 1)))


def test_one_triangle(tmp_path: Path) -> None:
    file = tmp_path / "triangle.obj"
    file.write_text("v -1 -1 0\nv 1 -1 0\nv 0 1 0\nf 1 2 3\n")
    check(scene(mesh={"type": "obj", "filename": str(file)}, light={"type": "constant"}))


@pytest.mark.parametrize("integrator", ["path", "direct"])
@pytest.mark.parametrize(
    ("light", "expected"), [(None, 0.0), ({"type": "constant", "radiance": 0.7}, 0.7), ({"type": "point"}, 0.0)],
    ids=["no light", "sky", "point"],
)  # fmt: skip
def test_no_geometry(integrator: str, light: dict[str, Any] | None, expected: float) -> None:
    things = {} if light is None else {"light": light}
    for precision in ("float32", "float64"):
        image = ours(scene(integrator={"type": integrator}, **things), spp=2, precision=precision)
        np.testing.assert_allclose(image, np.full((24, 24, 3), expected), rtol=1e-6)


def test_no_geometry_has_no_aovs() -> None:
    image = ours(scene(integrator={"type": "aov", "aovs": "d:depth,n:sh_normal,i:shape_index,u:duv_dx"}), spp=1)
    assert image.shape == (24, 24, 7) and (image == 0).all()


@pytest.mark.parametrize("integrator", ["path", "direct"])
def test_no_light_is_dark(integrator: str) -> None:
    assert (ours(scene(integrator={"type": integrator}, **corner(ball=ball())), spp=2) == 0).all()


# --- passes, seeds, precision, structures ---------------------------------------------------------------------------


def test_passes_add_up_to_the_same_image() -> None:
    loaded = rt.load_dict(room(film={"rfilter": {"type": "gaussian"}}))
    whole = np.array(render_detailed(loaded, spp=8).image)
    for lanes in (576 * 3, 100):  # by samples, and by pixels within a sample
        parts = np.array(render_detailed(loaded, spp=8, max_lanes=lanes, progress=False).image)
        np.testing.assert_allclose(parts, whole, rtol=1e-4, atol=1e-6)


def test_the_same_seed_gives_the_same_bits_and_another_one_others() -> None:
    first, again = (ours(room(), seed=3) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert (ours(room(), seed=4) != first).mean() > 0.5


def test_structures_give_the_same_bits() -> None:
    loaded = rt.load_dict(cornell_box(16))
    images = [np.array(rt.render(loaded, spp=4, accel=kind)) for kind in ("bvh", "brute_force")]
    np.testing.assert_array_equal(*images)


def test_float64_agrees_with_float32() -> None:
    single, double = (ours(cornell_box(16, max_depth=4), spp=64, precision=p) for p in ("float32", "float64"))
    assert single.dtype == np.float32 and double.dtype == np.float64
    # The two draw different numbers.
    np.testing.assert_allclose(single.mean(), double.mean(), rtol=0.1)
    sky = scene(light={"type": "directional", "direction": [-1, -1, -1]}, integrator={"type": "direct"}, **corner())
    single, double = (ours({**sky, "sensor": camera((16, 16))}, spp=64, precision=p) for p in ("float32", "float64"))
    inside = np.abs(single - double) < 1e-6 * single.max()
    assert inside.mean() > 0.9


def test_an_interrupted_render_keeps_what_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    loaded = rt.load_dict(room())
    calls = []
    add = Film.add

    def interrupted(self: Film, *arguments: Any, **named: Any) -> None:
        if len(calls) == 5:
            raise KeyboardInterrupt
        calls.append(None)
        add(self, *arguments, **named)

    monkeypatch.setattr(Film, "add", interrupted)
    with pytest.raises(rt.RenderInterrupted) as caught:
        render_detailed(loaded, spp=8, max_lanes=300, progress=False)  # two passes to every sample of the image
    monkeypatch.undo()
    partial = caught.value.partial
    assert partial is not None and partial.spp == 2 and partial.channels == ["R", "G", "B"]
    image = np.array(partial.image)
    assert image.shape == (24, 24, 3) and np.isfinite(image).all() and image.mean() > 0
    assert issubclass(rt.RenderInterrupted, KeyboardInterrupt)


def test_samples_that_are_not_finite_are_counted_and_left_out() -> None:
    # What shines almost as brightly as a float can and reflects as much again overflows.
    wall = {"type": "cube", "flip_normals": True, "emitter": {"type": "area", "radiance": 3e38}, "bsdf": diffuse(0.9)}
    wall["to_world"] = mitsuba().ScalarTransform4f().scale(8)
    with pytest.warns(RuntimeWarning, match=r"\d+ samples were NaN or infinite"):
        image = ours(scene(wall=wall), spp=4)
    assert np.isfinite(image).all()


def test_settings_that_cannot_be_are_refused() -> None:
    loaded = rt.load_dict(room())
    for settings, message in (
        ({"sensor": 1}, "sensor 1"),
        ({"integrator": "photon"}, "photon"),
        ({"filter": "ewa2"}, "ewa2"),
        ({"size": (0, 4)}, "0 x 4"),
        ({"spp": -1}, "-1"),
        ({"precision": "float16"}, "float16"),
    ):
        with pytest.raises(rt.RayTraceError, match=message) as caught:
            rt.render(loaded, **settings)
        assert len(str(caught.value).splitlines()) == 1


def test_spp_zero_takes_the_scenes_count_and_size_replaces_the_films() -> None:
    loaded = rt.load_dict(room(sampler={"type": "independent", "sample_count": 6}, film=CROP, size=(40, 32)))
    assert render_detailed(loaded, spp=0).spp == 6
    assert render_detailed(loaded, spp=1, size=(20, 16)).image.shape == (6, 10, 3)


def test_an_integrator_takes_the_place_of_the_scenes() -> None:
    source = room()
    deep = ours({**source, "integrator": {"type": "path", "max_depth": 2}})
    chosen = np.array(rt.render(rt.load_dict(source), spp=16, integrator=Integrator("path", max_depth=2)))
    np.testing.assert_array_equal(deep, chosen)
    single = np.array(rt.render(rt.load_dict(source), spp=16, integrator="direct"))
    np.testing.assert_allclose(single.mean(), deep.mean(), rtol=0.1)


# --- what is compiled -----------------------------------------------------------------------------------------------


def largest_kernel(source: dict[str, Any], **settings: Any) -> tuple[str, int]:
    """The hash and the number of operations of the kernel that traces."""
    loaded = rt.load_dict(source)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        rt.render(loaded, spp=2, **settings)
        kernels = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
    kernel = max(kernels, key=lambda k: k["operation_count"])
    return str(kernel["hash"]), int(kernel["operation_count"])


def plain(bsdf: dict[str, Any] | None = None, **settings: Any) -> dict[str, Any]:
    sensor = settings.pop("sensor", camera((16, 16)))
    things = {"lamp": lamp(), "ball": ball(bsdf), **settings.pop("more", {})}
    return scene(sensor=sensor, **corner(**things), **settings)


def test_values_do_not_recompile_the_kernel() -> None:
    wanted, _ = largest_kernel(plain())
    moved = camera((16, 16), fov=20.0, near_clip=0.1)
    moved["to_world"] = mitsuba().ScalarTransform4f().look_at(origin=[1, 1, 4], target=[0, 0, 0], up=[0, 1, 0])
    unused = {"type": "dielectric", "id": "unused"}
    for changed in (
        plain(diffuse(0.1, 0.7, 0.3)),
        plain(sensor=moved),
        plain(integrator={"type": "path", "max_depth": 3, "rr_depth": 2}),
        plain(more={"lamp": lamp(9.0, y=1.5, size=0.2)}),
        plain(more={"ball": ball(radius=0.4, center=[0.5, 0, 0])}),
        plain(more={"unused": unused}),
    ):
        assert largest_kernel(changed)[0] == wanted
    assert largest_kernel(plain(), seed=5)[0] == wanted


def test_the_size_of_the_film_does_not_recompile_the_kernel() -> None:
    assert largest_kernel(plain(sensor=camera((20, 12))))[0] == largest_kernel(plain())[0]


def test_what_a_scene_does_not_use_is_not_in_its_kernel() -> None:
    _, least = largest_kernel(plain())
    mi = mitsuba()
    image = {"type": "bitmap", "bitmap": mi.Bitmap(texels()), "raw": True}
    glass = largest_kernel(plain({"type": "dielectric"}))[1]
    mirror = largest_kernel(plain({"type": "conductor"}))[1]
    textured = largest_kernel(plain({"type": "diffuse", "reflectance": image}))[1]
    sky = largest_kernel(plain(more={"sky": {"type": "envmap", "bitmap": mi.Bitmap(texels())}}))[1]
    lens = largest_kernel(plain(sensor=camera((16, 16), "thinlens", aperture_radius=0.1, focus_distance=5.0)))[1]
    masked = largest_kernel(plain({"type": "mask", "opacity": 0.5, "inside": diffuse(0.5)}))[1]
    assert least < min(glass, mirror, textured, sky, lens, masked)
    # Nor is there anything to sample where nothing shines, or to shade where nothing is shaded.
    dark = plain(more={"lamp": ball(center=[0, 1, 0])})
    assert largest_kernel(dark)[1] < least
    depth = plain(integrator={"type": "aov", "aovs": "d:depth"})
    assert largest_kernel(depth)[1] < least / 2
