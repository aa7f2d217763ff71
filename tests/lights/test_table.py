import drjit as dr
import light_cases as cases
import mitsuba as mi
import numpy as np
import pytest

from raytrace2.errors import SceneError
from raytrace2.lights import NO_LIGHT
from raytrace2.scene import description as d
from raytrace2.types import types

T = types("float32")
SHAPES = cases.shapes()
SPOT = d.SpotLight(cases.transform(cases.rotation(6), (0.5, 0.2, 1)), (3, 2, 1), 40, 25)
SLIM = d.SpotLight(cases.transform(2 * cases.rotation(7), (0.5, 0.2, 1)), (3, 2, 1), 0.01, 0.01)
DELTAS = {
    "point": (d.PointLight((1, 2, 3), (4, 5, 6)), {"type": "point", "position": [1, 2, 3]}, (4, 5, 6), "intensity"),
    "spot": (SPOT, {"type": "spot", "cutoff_angle": 40, "beam_width": 25}, (3, 2, 1), "intensity"),
    "slim": (SLIM, {"type": "spot", "cutoff_angle": 0.01, "beam_width": 0.01}, (3, 2, 1), "intensity"),
    "directional": (
        d.DirectionalLight((1, -2, 0.5), (1, 2, 3)),
        {"type": "directional", "direction": [1, -2, 0.5]},
        (1, 2, 3),
        "irradiance",
    ),
    "constant": (d.ConstantLight((1, 2, 3)), {"type": "constant"}, (1, 2, 3), "radiance"),
}


@pytest.fixture(autouse=True, scope="module")
def variant():
    mi.set_variant("llvm_ad_rgb")


def mitsuba_light(name):
    light, entry, value, key = DELTAS[name]
    entry = {**entry, key: {"type": "rgb", "value": list(value)}}
    if isinstance(light, d.SpotLight):
        entry["to_world"] = mi.ScalarTransform4f(light.to_world)
    return light, entry


@pytest.mark.parametrize("name", DELTAS)
def test_each_light_agrees_with_mitsuba(name):
    light, entry = mitsuba_light(name)
    box = {"type": "cube", "to_world": mi.ScalarTransform4f().scale([3, 2, 4])}
    scene, table = mi.load_dict({"type": "scene", "light": entry, "box": box}), cases.build([light])
    n = 20000
    p = np.random.default_rng(0).normal(size=(3, n)).astype(np.float32) * 3
    if isinstance(light, d.SpotLight):  # half of them about the axis
        depth = np.random.default_rng(1).random(n // 2) * 5
        p[:, : n // 2] = (light.to_world[:3, 3:] + light.to_world[:3, 2:3] * depth).astype(np.float32)
    u = cases.samples(n)
    ours = table.sample(T.Array3f(p), u, T.Bool(True))
    it = dr.zeros(mi.SurfaceInteraction3f, n)
    it.p = mi.Point3f(p)
    theirs, weight = scene.sample_emitter_direction(it, mi.Point2f(u), False)
    if name == "slim":
        # Mitsuba finds angles of 2e-4 from cosines that round to 1: only a share that lies well inside can agree.
        weight = np.where(weight.numpy() > 0, weight.numpy(), ours.weight.numpy())
        assert (ours.weight.numpy() > 0).mean() > 0.3
    assert np.allclose(ours.weight.numpy(), weight if name == "slim" else weight.numpy(), rtol=1e-4, atol=1e-5)
    assert np.allclose(ours.d.numpy(), theirs.d.numpy(), atol=1e-6)
    assert np.allclose(ours.dist.numpy(), theirs.dist.numpy(), rtol=1e-3)
    lit = ours.weight.numpy()[0] > 0
    assert np.allclose(np.where(lit, ours.pdf.numpy(), 0), np.where(lit, theirs.pdf.numpy(), 0))
    assert (ours.delta.numpy() == (name != "constant")).all()
    assert (table.has_delta, table.has_environment, table.has_area) == (name != "constant", name == "constant", False)


def test_a_spots_texture_is_projected_like_mitsubas():
    pixels = np.random.default_rng(0).random((6, 7, 3)).astype(np.float32)
    light = d.SpotLight(SPOT.to_world, SPOT.intensity, 40, 25, d.BitmapTexture(pixels, raw=True))
    _, entry = mitsuba_light("spot")
    entry["texture"] = {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "raw": True}
    scene, table = mi.load_dict({"type": "scene", "light": entry}), cases.build([light, SPOT])
    p = np.random.default_rng(0).normal(size=(3, 20000)).astype(np.float32) * 3
    it = dr.zeros(mi.SurfaceInteraction3f, 20000)
    it.p = mi.Point3f(p)
    first = T.Array2f(0.25, 0.5)
    ours = table.sample(T.Array3f(p), first, T.Bool(True)).weight.numpy() / 2
    theirs = scene.sample_emitter_direction(it, mi.Point2f(0.25, 0.5), False)[1].numpy()
    assert (ours > 0).mean() > 0.05
    assert np.allclose(ours, theirs, rtol=2e-3, atol=1e-4)
    plain = table.sample(T.Array3f(p), T.Array2f(0.75, 0.5), T.Bool(True)).weight.numpy() / 2
    assert np.allclose(plain, cases.build([SPOT]).sample(T.Array3f(p), first, T.Bool(True)).weight.numpy(), rtol=1e-6)


def everything(precision="float32"):
    image = np.random.default_rng(0).random((5, 8, 3)).astype(np.float32)
    lights = [d.EnvironmentLight(image), SPOT, *(DELTAS[k][0] for k in ("point", "directional"))]
    return lights, list(SHAPES.values()), cases.build(lights, SHAPES.values(), precision)


def test_all_kinds_together_are_the_sum_of_each_alone():
    """The estimate of the sum over lights equals the sum of the estimates, and each light is chosen equally often."""
    lights, shapes, table = everything()
    n = 1 << 17
    u = cases.samples(n, seed=3)
    p = T.Array3f(*np.random.default_rng(0).normal(size=(3, 1)).astype(np.float32) * 0.3)
    together = table.sample(p, u, T.Bool(True)).weight.numpy().astype(np.float64)
    alone = [cases.build([x]) for x in lights] + [cases.build(area=[x]) for x in shapes]
    parts = [x.sample(p, cases.samples(n, seed=4), T.Bool(True)).weight.numpy().astype(np.float64) for x in alone]
    expected = sum(x.mean(axis=1) for x in parts)
    error = np.sqrt((together.var(axis=1) + sum(x.var(axis=1) for x in parts)) / n)
    assert (np.abs(together.mean(axis=1) - expected) < 5 * error).all()
    assert table.count == len(lights) + len(shapes) and table.has_area and table.has_delta and table.has_environment


def test_densities_carry_the_choice_of_the_light():
    _, shapes, table = everything()
    p = T.Array3f(0.1, -0.2, 0.05)
    surface = T.UInt(0, 1, 2, 3, 4, 5, 1000)
    light = table.light_of(surface, T.Bool(True)).numpy()
    assert sorted(light[:5]) == [0, 1, 2, 3, 4] and (light[5:] == NO_LIGHT).all()
    for i, shape in enumerate(shapes):
        scene = mi.load_dict({"type": "scene", "shape": cases.mitsuba_shape(mi, shape)})
        one = cases.build(area=[shape]).sample(p, cases.samples(2000), T.Bool(True))
        si = scene.ray_intersect(mi.Ray3f(mi.Point3f(0.1, -0.2, 0.05), mi.Vector3f(one.d)))
        hit = cases.interaction(si, T)
        pdf = table.pdf_hit(p, hit, T.UInt(int(light[i])), hit.valid).numpy() * table.count
        ok = (one.pdf.numpy() > 0) & (pdf > 0) & (np.array(si.wi.z) > 0.05)
        ok &= np.isclose(np.array(si.t), one.dist.numpy(), rtol=1e-4)
        assert ok.mean() > 0.3
        assert np.allclose(pdf[ok], one.pdf.numpy()[ok], rtol=3e-3)
        radiance = table.radiance_at(hit, T.UInt(int(light[i])), hit.valid).numpy()
        assert np.allclose(radiance[:, ok], [[1], [2], [3]])
    nothing = dr.full(T.UInt, NO_LIGHT, 2000)
    assert not table.radiance_at(hit, nothing, T.Bool(True)).numpy().any()
    assert not table.pdf_hit(p, hit, nothing, T.Bool(True)).numpy().any()


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_inside_a_symbolic_loop(precision):
    t = types(precision)
    *_, table = everything(precision)
    n = 64
    u = cases.samples(n, precision)

    def body(i, total, p):
        s = table.sample(p, t.Array2f(u.x, dr.fma(t.Float(i), 0.2, 0.1) * u.y), t.Bool(True))
        radiance, pdf = table.environment_with_pdf(s.d, s.pdf > 0)
        return i + 1, total + s.weight + radiance * pdf, p + s.d * 0.01

    state = (dr.zeros(t.UInt, n), dr.zeros(t.Array3f, n), dr.zeros(t.Array3f, n))
    _, looped, _ = dr.while_loop(state, lambda i, total, p: i < 4, body, mode="symbolic")
    for _ in range(4):
        state = body(*state)
    assert np.allclose(looped.numpy(), state[1].numpy(), rtol=1e-5)


def test_the_choice_keeps_the_rest_of_the_sample():
    lights = [d.ConstantLight(), d.PointLight((0, 0, 1)), d.PointLight((0, 0, 2))]
    table = cases.build(lights)
    x = (np.arange(9000) + 0.5) / 9000
    u = T.Array2f(np.stack([x, x]).astype(np.float32))
    s = table.sample(T.Array3f(0, 0, 0), u, T.Bool(True))
    assert abs(s.delta.numpy().mean() - 2 / 3) < 1e-3
    assert np.allclose(s.pdf.numpy()[s.delta.numpy()], 1 / 3)
    phi = np.arctan2(s.d.numpy()[1], s.d.numpy()[0])[~s.delta.numpy()]
    assert np.ptp(phi) > 6.2


def test_a_scene_without_lights():
    table = cases.build()
    s = table.sample(T.Array3f(0, 0, 0), cases.samples(4), T.Bool(True))
    assert not s.weight.numpy().any() and not s.pdf.numpy().any()
    assert not table.environment(s.d, T.Bool(True)).numpy().any()
    assert not (table.has_area or table.has_delta or table.has_environment or table.count)
    assert (table.light_of(T.UInt(0, 7), T.Bool(True)).numpy() == NO_LIGHT).all()


def test_reference_points_on_and_far_from_delta_lights():
    *_, table = everything()
    p = np.array([[1, 2, 3], [0.5, 0.2, 1], [1e30, 0, 0], [1e-30, 0, 0], [1 + 1e-7, 2, 3], [1e37, -1e37, 1e37]]).T
    x = (np.arange(table.count) + 0.5) / table.count
    for light in x:
        u = T.Array2f(dr.opaque(T.Float, float(light)), 0.3)
        s = table.sample(T.Array3f(p.astype(np.float32)), u, T.Bool(True))
        for value in (s.d, s.weight, s.pdf, s.dist, s.p):
            assert np.isfinite(value.numpy()).all()


def test_bad_lights_are_refused_together():
    flat = np.diag([1.0, 1, 0, 1])
    with pytest.raises(SceneError) as error:
        cases.build(
            [
                d.ConstantLight(),
                d.ConstantLight(),
                d.DirectionalLight((0, 0, 0)),
                d.PointLight((0, np.nan, 0)),
                d.SpotLight(flat),
            ]
        )
    assert len(error.value.problems) == 4
