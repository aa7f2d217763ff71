import drjit as dr
import light_cases as cases
import mitsuba as mi
import numpy as np
import pytest

from raytrace2.errors import Location, SceneError
from raytrace2.scene import description as d
from raytrace2.types import types

T, T64 = types("float32"), types("float64")
SHAPES = cases.shapes()
REFERENCE = (0.1, -0.2, 0.05)


@pytest.fixture(autouse=True, scope="module")
def variant():
    mi.set_variant("llvm_ad_rgb")


def mitsuba_scene(shape):
    return mi.load_dict({"type": "scene", "shape": cases.mitsuba_shape(mi, shape)})


def mitsuba_interaction(p):
    it = dr.zeros(mi.SurfaceInteraction3f)
    it.p = mi.Point3f(p)
    return it


@pytest.mark.parametrize("name", SHAPES)
def test_samples_agree_with_mitsuba(name):
    """Weights, densities and distances, sample by sample."""
    scene, table, u = mitsuba_scene(SHAPES[name]), cases.build(area=[SHAPES[name]]), cases.samples(10000)
    ours = table.sample(T.Array3f(*REFERENCE), u, T.Bool(True))
    theirs, weight = scene.sample_emitter_direction(mitsuba_interaction(REFERENCE), mi.Point2f(u), False)
    lit = ours.weight.numpy()[0] > 0
    assert lit.mean() > 0.3
    assert (lit == (weight.numpy()[0] > 0)).mean() > 0.999
    # At grazing angles the cosine's rounding shows: it is absolute in the weight, relative in its inverse.
    assert np.allclose(ours.weight.numpy()[:, lit], weight.numpy()[:, lit], rtol=1e-4, atol=1e-5)
    assert np.allclose(1 / ours.pdf.numpy()[lit], 1 / theirs.pdf.numpy()[lit], rtol=1e-4, atol=1e-5)
    assert np.allclose(ours.dist.numpy()[lit], theirs.dist.numpy()[lit], rtol=1e-4)
    offset = ours.p.numpy() - np.array(REFERENCE)[:, None]
    assert np.allclose(ours.d.numpy() * ours.dist.numpy(), offset, atol=2e-6)
    assert not ours.delta.numpy().any()


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("mirror", [1, -1])
@pytest.mark.parametrize("kind", cases.PLUGINS)
def test_sampled_points_are_hits_that_emit(kind, mirror, flip):
    """Mitsuba's rays to our samples meet the light where we say, and the side that emits is the one that we say."""
    shape = cases.emissive(kind, cases.transform(cases.rotation(4) @ np.diag([0.5 * mirror, 0.5, 0.5])), flip)
    scene, table = mitsuba_scene(shape), cases.build(area=[shape])
    n = 5000
    origin = mi.Point3f(np.random.default_rng(2).normal(size=(3, n)).astype(np.float32) * 2)
    sample = table.sample(T.Array3f(origin), cases.samples(n), T.Bool(True))
    found = sample.pdf.numpy() > 0
    si = scene.ray_intersect(mi.Ray3f(origin, mi.Vector3f(sample.d)))
    near = np.isclose(np.array(si.t), sample.dist.numpy(), rtol=1e-3) & np.array(si.is_valid())
    if not flip or kind in (d.RectangleShape, d.DiskShape):  # others hide an inner side that emits
        assert near[found].mean() > 0.99 or not near.any()
    emitted = np.array(scene.emitters()[0].eval(si))
    hit = cases.interaction(si, T)
    radiance = table.radiance_at(hit, T.UInt(0), T.Bool(True)).numpy()
    assert np.allclose(radiance[:, near], emitted[:, near], rtol=1e-6)
    # At the rim the two sides lie closer together than the distances that tell them apart here.
    steep = np.abs(np.array(si.wi.z)) > 0.05
    agree = (emitted[0] > 0) == (sample.weight.numpy()[0] > 0)
    assert agree[near & steep].mean() > 0.999
    pdf = table.pdf_hit(T.Array3f(origin), hit, T.UInt(0), T.Bool(True)).numpy()
    both = near & found & steep & np.array(np.isclose(np.array(si.t), sample.dist.numpy(), rtol=1e-5))
    assert np.allclose(pdf[both], sample.pdf.numpy()[both], rtol=3e-3)
    it = mitsuba_interaction(origin)
    theirs = scene.pdf_emitter_direction(it, mi.DirectionSample3f(scene, si, it))
    lit = (emitted[0] > 0) & steep & (np.abs(np.linalg.norm(np.array(origin), axis=0) - 0.5) > 0.05)
    assert np.allclose(pdf[lit], np.array(theirs)[lit], rtol=3e-3)
    assert (pdf[~(emitted[0] > 0)] == 0).all()


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_irradiance_of_closed_form(precision):
    """A disk of radius r at height h over a facing receiver gives pi L r^2 / (r^2 + h^2); a sphere pi L (r/h)^2."""
    t = types(precision)
    down = np.diag([1.0, -1.0, -1.0])
    n = 1 << 18
    side = np.arange(512) / 512 + 0.5 / 512
    u = t.Array2f(np.stack(np.meshgrid(side, side)).reshape(2, n).astype(t.numpy))
    for h in (1e-3, 0.3, 2.0, 1e3, 1e6):
        for kind, linear, form in (
            (d.DiskShape, 0.5 * down, 0.25 / (0.25 + h * h)),
            (d.SphereShape, 0.5 * np.eye(3), (0.5 / (h + 0.5)) ** 2),
        ):
            height = h + 0.5 if kind is d.SphereShape else h
            shape = cases.emissive(kind, cases.transform(linear, (0, 0, height)))
            table = cases.build(area=[shape], precision=precision)
            s = table.sample(t.Array3f(0, 0, 0), u, t.Bool(True))
            estimate = float(dr.mean(s.weight.x * dr.maximum(s.d.z, 0))[0])
            if h >= 0.3:
                assert abs(estimate / (np.pi * form) - 1) < 2e-4
            assert np.isfinite(s.weight.numpy()).all()


def test_density_over_directions_is_one():
    """The density of every direction that meets the light, found by tracing it, sums to 1."""
    n = 400
    z, phi = np.meshgrid((np.arange(n) + 0.5) / n, (np.arange(2 * n) + 0.5) / n * np.pi, indexing="ij")
    radius = np.sqrt(1 - z * z)
    up = np.stack([radius * np.cos(phi), radius * np.sin(phi), z]).reshape(3, -1).astype(np.float32)
    for name in ("sphere", "rectangle", "disk", "mesh"):
        scene, table = mitsuba_scene(SHAPES[name]), cases.build(area=[SHAPES[name]])
        origin = mi.Point3f(*REFERENCE)
        si = scene.ray_intersect(mi.Ray3f(origin, mi.Vector3f(up)))
        hit = cases.interaction(si, T)
        pdf = table.pdf_hit(T.Array3f(*REFERENCE), hit, T.UInt(0), hit.valid).numpy()
        assert abs(pdf.mean() * 2 * np.pi - 1) < 1e-2, name


@pytest.mark.parametrize("distance", [1e-6, 1e-3, 1e2, 1e6])
def test_far_and_near_spheres_keep_their_precision(distance):
    """float32 against float64, from just above the sphere to where it is a speck."""
    shape = cases.emissive(d.SphereShape, cases.transform(np.eye(3) * 0.5, (0, 0, distance + 0.5)))
    results = []
    for precision in ("float32", "float64"):
        t = types(precision)
        s = cases.build(area=[shape], precision=precision).sample(
            t.Array3f(0, 0, 0), t.Array2f(cases.samples(1000).numpy().astype(t.numpy)), t.Bool(True)
        )
        results.append((s.pdf.numpy(), np.linalg.norm(s.d.numpy(), axis=0), s.weight.numpy()[0]))
    (pdf, length, weight), (pdf64, _, weight64) = results
    # (distance + 0.5) itself is rounded: a relative error of 6e-8 / distance in what is left.
    tolerance = 1e-4 if distance >= 1e-3 else 0.1
    assert np.allclose(pdf, pdf64, rtol=tolerance) and np.allclose(weight, weight64, rtol=tolerance)
    assert np.allclose(length, 1, atol=1e-6)


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_nothing_is_ever_infinite(name, precision):
    t = types(precision)
    shape = SHAPES[name]
    table = cases.build(area=[shape], precision=precision)
    on_it = table.sample(t.Array3f(*REFERENCE), cases.samples(300, precision), t.Bool(True)).p.numpy()
    rng = np.random.default_rng(5)
    points = [
        on_it,
        rng.normal(size=(3, 300)),
        rng.normal(size=(3, 300)) * 1e6,
        rng.normal(size=(3, 300)) * 1e30,
        on_it * (1 + 1e-6),
        np.tile([[1.0], [0.5], [2.0]], 300),
        np.tile([[5.0], [3.0], [2.0]], 300),
    ]
    p = t.Array3f(np.concatenate(points, axis=1).astype(t.numpy))
    u = t.Array2f(np.tile(cases.samples(300, precision).numpy(), len(points)))
    corners = t.Array2f(np.array([[0, 0, 1, 1], [0, 1, 0, 1.0]]).astype(t.numpy))
    for s in (table.sample(p, u, t.Bool(True)), table.sample(t.Array3f(*REFERENCE), corners, t.Bool(True))):
        for field in (s.d, s.dist, s.weight, s.pdf, s.p):
            assert np.isfinite(field.numpy()).all()
        assert ((s.weight.numpy() > 0).any(axis=0) <= (s.pdf.numpy() > 0)).all()


def test_shading_normals_choose_the_side_and_true_areas_the_density():
    tables = [cases.build(area=[cases.grid_mesh(smooth=s)]) for s in (False, True)]
    u = cases.samples(2000)
    below = [t.sample(T.Array3f(*REFERENCE), u, T.Bool(True)) for t in tables]
    assert np.allclose(below[0].pdf.numpy(), below[1].pdf.numpy(), rtol=1e-5)
    above = [t.sample(T.Array3f(0, 0, 9), u, T.Bool(True)) for t in tables]
    assert not any(s.weight.numpy().any() for s in above)
    # In the plane's own grazing directions only the tilted normals tell the sides apart.
    aside = [t.sample(T.Array3f(0, 50, 2), u, T.Bool(True)).weight.numpy()[0] > 0 for t in tables]
    assert (aside[0] != aside[1]).any()


def test_textured_lights_show_the_same_texture_to_samples_and_hits():
    pixels = np.random.default_rng(0).random((8, 8, 3)).astype(np.float32)
    texture = d.BitmapTexture(pixels, raw=True)
    for name, shape in SHAPES.items():
        textured = d.AreaLight(texture)
        shape = type(shape)(**{**vars(shape), "emitter": textured})
        plain = cases.build(area=[SHAPES[name]])
        table = cases.build(area=[shape])
        u = cases.samples(4000)
        s, white = (x.sample(T.Array3f(*REFERENCE), u, T.Bool(True)) for x in (table, plain))
        scene = mitsuba_scene(SHAPES[name])
        si = scene.ray_intersect(mi.Ray3f(mi.Point3f(*REFERENCE), mi.Vector3f(s.d)))
        hit = cases.interaction(si, T)
        seen = table.radiance_at(hit, T.UInt(0), hit.valid).numpy()
        sampled = s.weight.numpy() / np.maximum(white.weight.numpy()[0], 1e-20)
        ok = (seen[0] > 0) & (sampled[0] > 0) & np.isclose(np.array(si.t), s.dist.numpy(), rtol=1e-4)
        ok &= np.abs(np.array(si.wi.z)) > 0.05
        assert ok.mean() > 0.2
        difference = np.abs(seen - sampled)[:, ok]
        assert np.quantile(difference, 0.99) < 2e-3, name


def test_an_uneven_cylinder_still_integrates_to_its_area():
    linear = cases.rotation(2) @ np.array([[1, 0.3, 0], [0, 0.5, 0.1], [0, 0, 2.0]])
    table = cases.build(area=[cases.emissive(d.CylinderShape, cases.transform(linear))], precision="float64")
    far = T64.Array3f(1e4, 2e4, -1e4)
    s = table.sample(far, cases.samples(200000, "float64"), T64.Bool(True))
    phi, z = np.meshgrid((np.arange(2000) + 0.5) / 2000 * 2 * np.pi, 0.5)
    normal = np.cross(np.stack([-np.sin(phi), np.cos(phi), 0 * phi], -1) @ linear.T, linear[:, 2])
    towards = np.array([1.0, 2, -1]) / np.sqrt(6)
    projected = np.maximum(normal @ towards, 0).mean() * 2 * np.pi
    estimate = s.weight.numpy()[0] * 6e8
    assert abs(estimate.mean() - projected) < 5 * estimate.std() / np.sqrt(200000) + 1e-3 * projected


def test_what_cannot_emit_is_refused_by_name():
    where = Location("room.xml", 12)
    group = d.ShapeGroup("g", ())
    instance = d.InstanceShape(id="copy", group=group, to_world=np.eye(4), emitter=d.AreaLight(), location=where)
    empty = d.MeshShape(id="void", vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), np.uint32), emitter=d.AreaLight())
    attribute = cases.emissive(d.DiskShape, np.eye(4), texture=d.MeshAttributeTexture("vertex_color"))
    with pytest.raises(SceneError) as error:
        cases.build(area=[instance, empty, attribute])
    text = str(error.value)
    assert len(error.value.problems) == 3
    assert "room.xml:12" in text and "copy" in text and "void" in text and "DiskShape" in text
