import os
from pathlib import Path

import drjit as dr
import light_cases as cases
import mitsuba as mi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raytrace2.errors import FileError, SceneError
from raytrace2.scene import description as d
from raytrace2.types import types

T, T64 = types("float32"), types("float64")
TURN = cases.transform(cases.rotation(3))
IMAGE = (np.random.default_rng(0).random((9, 16, 3)) ** 4).astype(np.float32)


@pytest.fixture(autouse=True, scope="module")
def variant():
    mi.set_variant("llvm_ad_rgb")


def mitsuba_scene(image, to_world, scale):
    return mi.load_dict(
        {
            "type": "scene",
            "light": {
                "type": "envmap",
                "bitmap": mi.Bitmap(image),
                "scale": scale,
                "to_world": mi.ScalarTransform4f(to_world),
            },
        }
    )


def directions(n, seed=0):
    v = np.random.default_rng(seed).normal(size=(3, n))
    return v / np.linalg.norm(v, axis=0)


def grid(rows, columns):
    """World directions at the centres of equal steps in the map's theta and phi, and their solid angles."""
    theta, phi = np.meshgrid(
        (np.arange(rows) + 0.5) / rows * np.pi, (np.arange(columns) + 0.5) / columns * 2 * np.pi, indexing="ij"
    )
    v = np.stack([np.sin(phi) * np.sin(theta), np.cos(theta), -np.cos(phi) * np.sin(theta)])
    return T64.Array3f(TURN[:3, :3] @ v.reshape(3, -1)), (np.sin(theta) * (2 * np.pi**2 / (rows * columns))).ravel()


@pytest.mark.parametrize("shape", [(9, 16), (1, 1), (2, 5), (3, 1), (64, 33)])
@pytest.mark.parametrize("mirror", [1, -1])
def test_radiance_and_density_agree_with_mitsuba(shape, mirror):
    image = np.random.default_rng(1).random((*shape, 3)).astype(np.float32)
    to_world = TURN @ np.diag([mirror, 1, 1, 1])
    scene = mitsuba_scene(image, to_world, 1.7)
    table = cases.build([d.EnvironmentLight(image, to_world, 1.7)])
    v = directions(5000)
    w = T.Array3f(v.astype(np.float32))
    si = dr.zeros(mi.SurfaceInteraction3f, 5000)
    si.wi = -mi.Vector3f(w)
    radiance = np.array(scene.environment().eval(si))
    assert np.allclose(table.environment(w, T.Bool(True)).numpy(), radiance, rtol=1e-3, atol=1e-4)
    sample = dr.zeros(mi.DirectionSample3f, 5000)
    sample.d, sample.emitter = mi.Vector3f(w), mi.EmitterPtr(scene.environment())
    pdf = np.array(scene.pdf_emitter_direction(dr.zeros(mi.SurfaceInteraction3f, 5000), sample))
    away = np.abs(TURN[:3, 1] @ v) < np.cos(np.pi / (max(shape[0], 3) - 1))
    if away.any():
        ratio = (table.pdf_environment(w, T.Bool(True)).numpy() / pdf)[away]
        # The rows at the poles take a little of everybody's share.
        assert np.allclose(ratio, ratio.mean(), rtol=2e-3) and 0.75 < ratio.mean() <= 1


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_samples_say_the_density_and_radiance_of_their_direction(precision):
    t = types(precision)
    table = cases.build([d.EnvironmentLight(IMAGE, TURN, 1.7)], precision=precision)
    s = table.sample(t.Array3f(1, 2, 3), cases.samples(20000, precision), t.Bool(True))
    radiance, pdf = table.environment_with_pdf(s.d, t.Bool(True))
    tolerance = 1e-2 if precision == "float32" else 1e-9
    assert np.allclose(pdf.numpy(), s.pdf.numpy(), rtol=tolerance)
    assert np.allclose(radiance.numpy() / pdf.numpy(), s.weight.numpy(), rtol=tolerance)
    assert np.allclose(np.linalg.norm(s.d.numpy(), axis=0), 1, atol=1e-6)
    assert np.allclose(s.p.numpy() - s.d.numpy() * s.dist.numpy(), [[1], [2], [3]], atol=1e-5)
    assert (np.linalg.norm(s.p.numpy(), axis=0) >= cases.RADIUS).all()


@pytest.mark.parametrize("case", ["random", "constant", "one pixel", "one pole", "black"])
def test_density_is_one_and_the_estimate_unbiased(case):
    image = {"random": IMAGE, "constant": np.ones((9, 16, 3), np.float32)}.get(case, np.zeros((9, 16, 3), np.float32))
    if case == "one pixel":
        image[5, 15] = 1e4
    if case == "one pole":
        image[0, 3] = 1e4
    table = cases.build([d.EnvironmentLight(image, TURN, 1.0)], precision="float64")
    v, solid = grid(900, 1800)
    radiance, pdf = (x.numpy() for x in table.environment_with_pdf(v, T64.Bool(True)))
    assert abs((pdf * solid).sum() - (case != "black")) < 1e-3
    n = 100000
    weight = table.sample(T64.Array3f(0, 0, 0), cases.samples(n, "float64"), T64.Bool(True)).weight.numpy()
    truth = (radiance * solid).sum(axis=1)
    assert (np.abs(weight.mean(axis=1) - truth) <= 5 * weight.std(axis=1) / np.sqrt(n) + 2e-4 * truth).all()


def test_noise_is_no_worse_than_mitsubas():
    table, scene = cases.build([d.EnvironmentLight(IMAGE, TURN, 1.0)]), mitsuba_scene(IMAGE, TURN, 1.0)
    u = cases.samples(200000)
    ours = table.sample(T.Array3f(0, 0, 0), u, T.Bool(True)).weight.numpy()
    _, theirs = scene.sample_emitter_direction(dr.zeros(mi.SurfaceInteraction3f), mi.Point2f(u), False)
    assert (ours.std(axis=1) < 1.02 * theirs.numpy().std(axis=1)).all()
    error = np.hypot(ours.std(axis=1), theirs.numpy().std(axis=1)) / np.sqrt(200000)
    assert (np.abs(ours.mean(axis=1) - theirs.numpy().mean(axis=1)) < 5 * error).all()


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 6),
    st.integers(1, 6),
    st.sampled_from(["float32", "float64"]),
    st.sampled_from([0.0, 1e-30, 1.0, 1e30]),
)
def test_nothing_is_ever_infinite(seed, height, width, precision, peak):
    t = types(precision)
    rng = np.random.default_rng(seed)
    image = (rng.random((height, width, 3)) * (rng.random((height, width, 1)) > 0.6) * peak).astype(np.float32)
    table = cases.build([d.EnvironmentLight(image, TURN, 1.0)], precision=precision)
    u = np.concatenate([rng.random((2, 64)), [[0, 0, 1, 1, 0.5], [0, 1, 0, 1, 1]]], axis=1)
    axes = np.concatenate([np.eye(3), -np.eye(3), TURN[:3, :3], -TURN[:3, :3]], axis=1)
    s = table.sample(t.Array3f(0, 1e6, 0), t.Array2f(u.astype(t.numpy)), t.Bool(True))
    radiance, pdf = table.environment_with_pdf(t.Array3f(axes.astype(t.numpy)), t.Bool(True))
    for value in (s.d, s.dist, s.weight, s.pdf, s.p, radiance, pdf):
        assert np.isfinite(value.numpy()).all()
    if not image.any():
        assert not s.weight.numpy().any()


def test_bad_maps_are_refused_by_name():
    bad = IMAGE.copy()
    bad[3, 4, 1] = np.nan
    with pytest.raises(FileError, match="sky.exr"):
        cases.build([d.EnvironmentLight(bad, TURN, 1.0, "sky.exr")])
    with pytest.raises(SceneError, match="rotation"):
        cases.build([d.EnvironmentLight(IMAGE, np.diag([1.0, 2, 1, 1]), 1.0)])
    scaled = cases.build([d.EnvironmentLight(IMAGE, TURN @ np.diag([7.0, 7, 7, 1]), 1.0)])
    same = cases.build([d.EnvironmentLight(IMAGE, TURN, 1.0)])
    w = T.Array3f(directions(100).astype(np.float32))
    assert np.allclose(*(x.environment(w, T.Bool(True)).numpy() for x in (scaled, same)), atol=1e-5)


DATA = Path(os.environ.get("RAYTRACE2_MITSUBA_DATA", "."))
MUSEUM = DATA / "common" / "textures" / "museum.exr"


@pytest.mark.skipif(not MUSEUM.is_file(), reason="RAYTRACE2_MITSUBA_DATA does not hold common/textures/museum.exr")
def test_museum():
    image = np.array(mi.Bitmap(str(MUSEUM)).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False))
    to_world = np.array(mi.ScalarTransform4f().rotate([0, 1, 0], 180).matrix)
    scene, table = mitsuba_scene(image, to_world, 1.0), cases.build([d.EnvironmentLight(image, to_world, 1.0)])
    w = T.Array3f(directions(100000).astype(np.float32))
    si = dr.zeros(mi.SurfaceInteraction3f, 100000)
    si.wi = -mi.Vector3f(w)
    radiance, pdf = table.environment_with_pdf(w, T.Bool(True))
    theirs = np.array(scene.environment().eval(si))
    assert np.quantile(np.abs(radiance.numpy() - theirs) / np.maximum(theirs, 1e-6), 0.999) < 2e-2
    sample = dr.zeros(mi.DirectionSample3f, 100000)
    sample.d, sample.emitter = mi.Vector3f(w), mi.EmitterPtr(scene.environment())
    ratio = pdf.numpy() / np.array(scene.pdf_emitter_direction(dr.zeros(mi.SurfaceInteraction3f, 100000), sample))
    assert np.quantile(np.abs(ratio - 1), 0.99) < 1e-2
    u = cases.samples(200000)
    ours = table.sample(T.Array3f(0, 0, 0), u, T.Bool(True)).weight.numpy()
    _, weight = scene.sample_emitter_direction(dr.zeros(mi.SurfaceInteraction3f), mi.Point2f(u), False)
    theirs = weight.numpy()
    error = np.hypot(ours.std(axis=1), theirs.std(axis=1)) / np.sqrt(200000)
    assert (np.abs(ours.mean(axis=1) - theirs.mean(axis=1)) < 5 * error).all()
    assert (ours.std(axis=1) < 1.05 * theirs.std(axis=1)).all()
