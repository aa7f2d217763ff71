"""What queries cost, how they behave inside loops, and how interactions move with their rays."""

import drjit as dr
import numpy as np
import pytest
import surface_cases as cases

import raytrace2 as rt
from raytrace2 import accel
from raytrace2.rays.ray import Ray
from raytrace2.surfaces.instance import Instance
from raytrace2.surfaces.quadrics import Cylinder, Disk, Rectangle, Sphere
from raytrace2.types import types


def operations(items, query):
    """The operations of all kernels that a query of ``items`` runs."""
    structure = accel.build(items)
    ray = Ray(*cases.rays(64))
    structure.interact(ray, structure.intersect(ray))  # makes buffers
    dr.eval(ray.o, ray.d, ray.tmin, ray.tmax)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        dr.eval(query(structure, ray))
        return sum(k["operation_count"] for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT)


def test_kinds_that_are_absent_cost_nothing():
    triangles = cases.mesh(False, False)
    queries = {
        "intersect": lambda s, r: s.intersect(r),
        "occluded": lambda s, r: s.occluded(r),
        "interact": lambda s, r: s.interact(r, s.intersect(r)),
    }
    for query in queries.values():
        bare = operations([triangles], query)
        more = [
            [triangles, Sphere()],
            [triangles, Sphere(), Cylinder()],
            [triangles, Sphere(), Cylinder(), Instance(accel.build(triangles))],
        ]
        counts = [bare, *(operations(items, query) for items in more)]
        assert counts == sorted(set(counts))
    interact = queries["interact"]
    assert operations([triangles], interact) < operations([cases.mesh(False, True)], interact)
    assert operations([triangles], interact) < operations([cases.mesh(True, False)], interact)


@pytest.mark.parametrize("kind", accel.names())
def test_a_loop_of_bounces_is_the_bounces_one_by_one(kind):
    structure = accel.build(cases.everything("float32"), kind)
    structure.geometry.shading  # noqa: B018 - buffers are made before the loop is recorded
    t = types("float32")

    def bounce(o, d, active, length):
        ray = Ray.of(o, d)
        hit = structure.intersect(ray, active)
        si = structure.interact(ray, hit)
        mirrored = d - si.n * (2 * dr.dot(si.n, d))
        out = si.spawn_ray(mirrored)
        active = active & si.valid & ~structure.occluded(si.spawn_ray(si.n, 1e-3), active)
        o, d = dr.select(si.valid, out.o, o), dr.select(si.valid, out.d, d)
        return o, d, active, length + dr.select(si.valid, hit.t, 0)

    o, d = (t.Array3f(np.ascontiguousarray(v.T.astype(np.float32))) for v in cases.rays(2000))
    start = o, d, dr.full(t.Bool, True, 2000), dr.zeros(t.Float, 2000)
    state = start
    for _ in range(4):
        state = bounce(*state)
        dr.eval(state)
    looped = dr.while_loop(
        (dr.zeros(t.UInt, 2000), *start),
        lambda i, o, d, active, length: (i < 4) & active,
        lambda i, *state: (i + 1, *bounce(*state)),
        mode="symbolic",
    )[1:]
    assert (state[3].numpy() > 0).sum() > 500
    for one, other in zip(state, looped, strict=True):
        np.testing.assert_allclose(np.array(one, float), np.array(other, float), rtol=1e-4, atol=1e-4)


def outputs(si):
    return {"t": si.t, "p": si.p, "n": si.n, "sh_n": si.sh_frame.n, "uv": si.uv, "dp_du": si.dp_du, "wi": si.wi}


SHAPES = {
    "mesh": [cases.mesh(True, True)],
    "bare mesh": [cases.mesh(False, False)],
    **{k: [kind(cases.matrix(1, cases.SCALES[k]))] for k, kind in cases.QUADRICS.items()},
    "instance": None,
    "everything": None,
}


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("moving", ["o", "d"])
def test_interactions_move_with_their_rays(name, moving):
    items = SHAPES[name]
    if name == "instance":
        items = [Instance(cases.group("float64")[1], cases.matrix(5, (0.5, 0.9, 0.7), True))]
    elif name == "everything":
        items = cases.everything("float64")
    structure = accel.build(items, precision="float64")
    t = types("float64")
    o, d = cases.rays(1000)
    rng = np.random.default_rng(4)
    step = rng.normal(size=o.shape)
    h = 1e-6

    def at(x):
        ray = Ray(o + step * x, d, precision="float64") if moving == "o" else Ray(o, d + step * x, precision="float64")
        hit = structure.intersect(ray)
        return hit, outputs(structure.interact(ray, hit))

    (before, low), (middle, _), (after, high) = at(-h), at(0), at(h)
    same = (before.prim == middle.prim) & (after.prim == middle.prim)
    same &= (before.surface == middle.surface) & (after.surface == middle.surface) & middle.valid
    same &= (before.instance == middle.instance) & (after.instance == middle.instance)
    keep = same.numpy()
    assert keep.sum() > 50

    ray = Ray(o, d, precision="float64")
    vector = getattr(ray, moving)
    dr.enable_grad(vector)
    dr.set_grad(vector, t.Array3f(step.T.copy()))
    hit = structure.intersect(ray)
    found = outputs(structure.interact(ray, hit))
    dr.forward_to(*found.values(), flags=dr.ADFlag.ClearEdges)
    for key, value in found.items():
        ours = np.atleast_2d(np.array(dr.grad(value)))[:, keep]
        after, before = (np.atleast_2d(np.array(side[key]))[:, keep] for side in (high, low))
        theirs = (after - before) / (2 * h)
        assert np.isfinite(ours).all(), key
        scale = 1 + np.abs(theirs).max(axis=0)
        error = np.abs(ours - theirs).max(axis=0) / scale
        # Close to silhouettes curvature spoils the difference quotient, and azimuths jump.
        assert np.quantile(error, 0.95) < 1e-5, key


@pytest.mark.parametrize("kind", [Sphere, Cylinder, Disk, Rectangle])
def test_backward_derivatives_are_finite_on_a_miss(kind):
    structure = accel.build([kind(), cases.mesh(True, True)], precision="float64")
    ray = Ray([[0, 0, 9], [9, 9, 9], [0, 0, 9]], [[0, 0, -1], [0, 1, 0], [1e-9, 0, -1]], precision="float64")
    dr.enable_grad(ray.o, ray.d)
    hit = structure.intersect(ray)
    si = structure.interact(ray, hit)
    total = dr.sum(dr.sum(si.p) + dr.sum(si.n) + dr.sum(si.sh_frame.s) + dr.sum(si.wi) + dr.sum(si.dp_dv))
    dr.backward(total)
    assert np.isfinite(dr.grad(ray.o).numpy()).all()
    assert np.isfinite(dr.grad(ray.d).numpy()).all()


def test_interact_without_derivatives_costs_no_more():
    sphere = [Sphere()]
    plain = operations(sphere, lambda s, r: s.interact(r, s.intersect(r)))

    def attached(s, r):
        dr.enable_grad(r.o)
        return dr.detach(s.interact(r, s.intersect(r)))

    assert plain <= operations(sphere, attached)


def test_hits_that_were_made_up_crash_nothing() -> None:
    mesh = rt.TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    scene = rt.accel.build([mesh, rt.Sphere(), rt.Instance(rt.accel.build(rt.Disk()))])
    ray = rt.Ray([[0, 0, -2]] * 4, [[0, 0, 1]] * 4)
    hit = scene.intersect(ray)
    hit.surface = type(hit.surface)([0, 1, 7, 2**31])
    hit.prim = type(hit.prim)([2**30, 5, 0, 0xFFFFFFFF])
    hit.instance = type(hit.instance)([2**31, 3, 0, 9])
    assert np.array(scene.interact(ray, hit).valid).tolist() == [True, True, False, False]
