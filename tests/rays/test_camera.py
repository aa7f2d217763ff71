from __future__ import annotations

from dataclasses import replace

import drjit as dr
import numpy as np
import pytest

from raytrace2.errors import SceneError
from raytrace2.rays.camera import make_camera
from raytrace2.scene.description import Film, OrthographicCamera, PerspectiveCamera, ThinLensCamera
from raytrace2.types import types

mi = pytest.importorskip("mitsuba")
if mi.variant() is None:
    mi.set_variant("llvm_ad_rgb")

N = 4096
CROPS = [(64, 48, 0, 0, 64, 48), (64, 48, 7, 11, 20, 30), (5, 9, 4, 8, 1, 1), (1, 1, 0, 0, 1, 1)]


def film_of(crop):
    return Film(*crop[:2], *crop[2:])


def look_at():
    return np.array(
        mi.ScalarTransform4f().look_at(origin=[1, -2, 3], target=[4, 1, -0.5], up=[0, 0.2, 1]).matrix, dtype=float
    )


def describe(kind, crop, to_world=None):
    common = dict(
        to_world=look_at() if to_world is None else to_world, near_clip=0.3, far_clip=70.0, film=film_of(crop)
    )
    if kind == "perspective":
        return PerspectiveCamera(x_fov=50.0, principal_point_offset_x=0.1, principal_point_offset_y=-0.2, **common)
    if kind == "thinlens":
        return ThinLensCamera(x_fov=70.0, aperture_radius=0.4, focus_distance=2.5, **common)
    return OrthographicCamera(**common)


def mitsuba_sensor(kind, desc):
    film = desc.film
    settings = {
        "type": kind,
        "to_world": mi.ScalarTransform4f(desc.to_world),
        "near_clip": desc.near_clip,
        "far_clip": desc.far_clip,
        "film": {
            "type": "hdrfilm", "width": film.width, "height": film.height,
            "crop_offset_x": film.crop_offset_x, "crop_offset_y": film.crop_offset_y,
            "crop_width": film.crop_width, "crop_height": film.crop_height,
        },
    }  # fmt: skip
    if kind != "orthographic":
        settings |= {"fov": desc.x_fov, "fov_axis": "x"}
    if kind == "perspective":
        settings |= {
            "principal_point_offset_x": desc.principal_point_offset_x,
            "principal_point_offset_y": desc.principal_point_offset_y,
        }
    if kind == "thinlens":
        settings |= {"aperture_radius": desc.aperture_radius, "focus_distance": desc.focus_distance}
    return mi.load_dict(settings)


def samples(t, seed):
    values = np.random.default_rng(seed).random((2, N))
    return t.Array2f(values.astype(t.numpy))


@pytest.mark.parametrize("kind", ["perspective", "thinlens", "orthographic"])
@pytest.mark.parametrize("crop", CROPS)
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_rays_are_those_of_mitsuba(kind, crop, precision):
    t = types(precision)
    scale = np.diag([2.0, 3.0, 4.0, 1.0]) if kind == "orthographic" else np.eye(4)
    desc = describe(kind, crop, look_at() @ scale)
    film, aperture = samples(t, 1), samples(t, 2)
    ray = make_camera(desc, t).sample_ray(film, aperture)
    theirs, weight = mitsuba_sensor(kind, desc).sample_ray(0, 0, mi.Point2f(film), mi.Point2f(aperture))
    assert dr.type_v(ray.d) == dr.type_v(t.Float)
    assert np.abs(np.array(ray.o) - np.array(theirs.o)).max() < 3e-6
    assert np.abs(np.array(ray.d) - np.array(theirs.d)).max() < 1e-6
    assert np.allclose(np.array(ray.tmax), np.array(theirs.maxt), rtol=1e-6)
    assert dr.all(ray.tmin == 0)


@pytest.mark.parametrize("kind", ["perspective", "thinlens", "orthographic"])
def test_forward_derivative_agrees_with_finite_differences(kind):
    t = types("float64")
    camera = make_camera(describe(kind, CROPS[1]), t)
    film, aperture = samples(t, 3), samples(t, 4)
    step = 1e-6
    for axis in range(2):
        shift = t.Array2f(step * (axis == 0), step * (axis == 1))
        position = t.Array2f(film)
        dr.enable_grad(position)
        ray = camera.sample_ray(position, aperture)
        dr.set_grad(position, shift / step)
        do, dd = dr.forward_to(ray.o, ray.d)
        plus, minus = camera.sample_ray(film + shift, aperture), camera.sample_ray(film - shift, aperture)
        for ours, high, low in ((do, plus.o, minus.o), (dd, plus.d, minus.d)):
            expected = (np.array(high) - np.array(low)) / (2 * step)
            assert np.abs(np.broadcast_to(np.array(ours), expected.shape) - expected).max() < 2e-9


@pytest.mark.parametrize("kind", ["perspective", "thinlens", "orthographic"])
def test_moving_the_camera_reuses_the_kernel(kind):
    t = types("float32")
    film, aperture = samples(t, 5), samples(t, 6)
    dr.eval(film, aperture)
    hashes = []
    for angle in (0.0, 0.3):
        turn = np.array(mi.ScalarTransform4f().rotate([0, 1, 0], 20 * angle).matrix, dtype=float)
        desc = replace(describe(kind, CROPS[0], turn), near_clip=0.1 + angle)
        camera = make_camera(desc, t)
        dr.eval()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            ray = camera.sample_ray(film, aperture)
            dr.eval(ray)
            hashes.append({k["hash"] for k in dr.kernel_history([dr.KernelType.JIT])})
    assert hashes[0] and hashes[0] == hashes[1]


def test_every_ray_field_has_the_full_width():
    t = types("float32")
    for kind in ("perspective", "thinlens", "orthographic"):
        ray = make_camera(describe(kind, CROPS[0]), t).sample_ray(samples(t, 7), samples(t, 8))
        assert all(dr.width(part) == N for part in (*ray.o, *ray.d, ray.tmax))


def test_a_closed_aperture_is_a_pinhole():
    t = types("float64")
    lens = describe("thinlens", CROPS[0])
    pinhole = PerspectiveCamera(
        to_world=lens.to_world, near_clip=lens.near_clip, far_clip=lens.far_clip, film=lens.film, x_fov=lens.x_fov
    )
    film = samples(t, 9)
    a = make_camera(replace(lens, aperture_radius=0.0), t).sample_ray(film, samples(t, 10))
    b = make_camera(pinhole, t).sample_ray(film)
    assert np.abs(np.array(a.d) - np.array(b.d)).max() < 1e-15
    assert np.abs(np.array(a.o) - np.array(b.o)).max() < 1e-14


def test_rays_meet_at_the_focus_distance():
    t = types("float64")
    desc = describe("thinlens", CROPS[0], np.eye(4))
    ray = make_camera(desc, t).sample_ray(dr.full(t.Array2f, 0.25, N), samples(t, 11))
    points = np.array(ray((desc.focus_distance - ray.o.z) / ray.d.z))
    assert np.ptp(points, axis=1).max() < 1e-14


@pytest.mark.parametrize(
    "change",
    [
        {"to_world": np.diag([2.0, 2.0, 2.0, 1.0])},
        {"to_world": np.full((4, 4), np.nan)},
        {"to_world": np.ones((4, 4))},
        {"x_fov": 0.0},
        {"x_fov": 180.0},
        {"x_fov": float("nan")},
        {"near_clip": 0.0},
        {"near_clip": 100.0},
        {"aperture_radius": -1.0},
        {"focus_distance": 0.0},
    ],
)
def test_cameras_that_cannot_be_are_refused_in_one_line(change):
    desc = replace(describe("thinlens", CROPS[0]), id="eye", **change)
    with pytest.raises(SceneError, match="sensor 'eye'") as error:
        make_camera(desc, types("float32"))
    assert "\n" not in str(error.value)
