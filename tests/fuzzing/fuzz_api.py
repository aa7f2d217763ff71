# ruff: noqa: E501 -- a case a line
"""Calls with arrays and settings of every wrong kind; unusual but right ones must give what the usual ones give."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np
from drjit.llvm import ad
from fuzz_judge import Nonsense
from fuzz_seeds import BASIC, FACES, UV, VERTICES

import raytrace2 as rt

SAME, REFUSE, ANY = "same", "refuse", "any"
Verdict = str


def api_case(rng: random.Random) -> Callable[[], None]:
    """A call that checks its own result; :class:`Nonsense` where that is wrong."""
    return rng.choice(_FAMILIES)(rng)


def _odd_floats(good: np.ndarray, rng: random.Random) -> tuple[Any, Verdict]:
    """An array of numbers in another form, or no array of numbers."""
    n, k = good.shape
    spread = np.zeros((2 * n, 2 * k))
    spread[::2, ::2] = good
    wrong = good.copy()
    wrong[rng.randrange(n), rng.randrange(k)] = rng.choice((np.nan, np.inf, -np.inf))
    huge = good.copy()
    huge[rng.randrange(n), rng.randrange(k)] = 1e300
    frozen = good.copy()
    frozen.setflags(write=False)
    jit = {2: ad.Array2f, 3: ad.Array3f}[k](good.T.astype(np.float32)) if k in (2, 3) else good
    choices: list[tuple[Any, Verdict]] = [
        (np.asfortranarray(good), SAME), (spread[::2, ::2], SAME), (good[::-1][::-1], SAME), (good.astype(">f8"), SAME),
        (good.astype(np.float32), SAME), (frozen, SAME), (good.tolist(), SAME), (tuple(map(tuple, good)), SAME),
        (jit, SAME), (np.ma.array(good), SAME), (good.astype(np.float16), SAME), (good.astype(object), SAME),
        (wrong, REFUSE), (wrong.astype(np.float32), REFUSE), (wrong.tolist(), REFUSE), (huge, REFUSE), (good.T.copy()[:, :2], REFUSE),
        (good[:, :1], REFUSE), (good[None], REFUSE), (good[..., None], REFUSE), (good.astype(complex) + 1j, REFUSE),
        (good.astype(str), REFUSE), ("abc", REFUSE), (b"abc", REFUSE), (object(), REFUSE), ([[1, 2, 3], [1]], REFUSE),
        (np.array([[object()] * k]), REFUSE), (good.astype("datetime64[s]"), REFUSE), (np.zeros(n, [("a", "f4")]), REFUSE),
        (3.0, REFUSE), ({}, REFUSE), (lambda: 0, REFUSE), (good[0, 0], REFUSE), (np.ma.array(good, mask=good == 1), REFUSE),
        ([[10**400] * k] * n, REFUSE), (good > 0, ANY), (np.broadcast_to(good[0], (n, k)), ANY), (good[:0], ANY),
    ]  # fmt: skip
    return rng.choice(choices)


def _odd_faces(rng: random.Random) -> tuple[Any, Verdict]:
    f = FACES
    n = len(VERTICES)

    def at(value: Any, dtype: Any = np.int64) -> np.ndarray:
        out = f.astype(dtype)
        out[rng.randrange(len(f)), rng.randrange(3)] = value
        return out

    choices: list[tuple[Any, Verdict]] = [
        *[(f.astype(t), SAME) for t in (np.int8, np.uint8, ">i4", np.uint16, np.int32, np.uint64, np.float32, np.float64)],
        (np.asfortranarray(f), SAME), (f.tolist(), SAME), (f.ravel(), SAME), (ad.Array3u(f.T.astype(np.uint32)), SAME),
        (at(-1), REFUSE), (at(n), REFUSE), (at(2**32), REFUSE), (at(2**32 + 1), REFUSE), (at(-(2**32)), REFUSE), (at(2**63 - 1), REFUSE),
        (at(2**64 - 1, np.uint64), REFUSE), (at(0.5, float), REFUSE), (at(np.nan, float), REFUSE), (at(np.inf, float), REFUSE),
        (at(1e20, float), REFUSE), (at(-1.0, float), REFUSE), (at(255, np.uint8), REFUSE), (f > 0, REFUSE), (f.astype(complex), REFUSE),
        (f.astype(str), REFUSE), (f[:0], REFUSE), (f[:, :2], REFUSE), (f[None], REFUSE), (None, REFUSE), ("x", REFUSE), (3, REFUSE),
        ([[0, 1, 2], [0]], REFUSE), (f.astype(object), ANY), ([[10**30] * 3], REFUSE), ([], REFUSE), (f.ravel()[:-1], REFUSE),
        (np.array([[None] * 3]), REFUSE), ({}, REFUSE), (f.astype("timedelta64[s]"), REFUSE),
    ]  # fmt: skip
    return rng.choice(choices)


def _checked(
    verdict: Verdict, what: str, make: Callable[[], Any], compare: Callable[[Any], bool]
) -> Callable[[], None]:
    def call() -> None:
        try:
            made = make()
        except (rt.RayTraceError, TypeError, ValueError):
            if verdict == SAME:
                raise Nonsense(f"{what}: refused although it is right") from None
            raise
        if verdict == REFUSE:
            raise Nonsense(f"{what}: accepted although it is wrong")
        if verdict == SAME and not compare(made):
            raise Nonsense(f"{what}: gives something else than the usual form")
        if isinstance(made, rt.Surface):
            _trace(made)

    return call


def _trace(surface: rt.Surface) -> None:
    """Rays through what was made: hits at finite t with finite interactions."""
    ray = rt.Ray(np.random.default_rng(0).normal(size=(16, 3)) * 0.3 + [0, 0, 4], [0, 0, -1])
    structure = rt.accel.build(surface) if not hasattr(surface, "geometry") else surface
    hit = structure.intersect(ray)
    found = structure.interact(ray, hit)
    valid = np.array(hit.valid)
    for name in ("p", "n", "uv", "dp_du"):
        values = np.array(getattr(found, name))
        if not np.isfinite(values[:, valid]).all():
            raise Nonsense(f"interaction: {name} is not finite")


def _mesh(rng: random.Random) -> Callable[[], None]:
    arguments: dict[str, Any] = {"vertices": VERTICES, "faces": FACES, "uv": UV, "normals": np.ones((5, 3))}
    key = rng.choice(list(arguments))
    good = arguments[key]
    value, verdict = _odd_faces(rng) if key == "faces" else _odd_floats(good, rng)
    arguments[key] = value
    if verdict == ANY and key == "uv":
        verdict = ANY
    name = f"TriangleMesh {key}={_shown(value)}"
    return _checked(verdict, name, lambda: rt.TriangleMesh(**arguments), lambda m: np.allclose(getattr(m, key), good))


def _ray(rng: random.Random) -> Callable[[], None]:
    o = np.random.default_rng(3).integers(-4, 4, (5, 3)) / 4.0
    key = rng.choice(("o", "d", "tmin", "tmax"))
    arguments: dict[str, Any] = {"o": o, "d": [0.0, 0.0, -1.0], "tmin": 0.0, "tmax": np.inf}
    if key in "od":
        value, verdict = _odd_floats(o, rng)
        verdict = ANY if verdict == REFUSE and _is_numeric(value) else verdict
    else:
        value, verdict = rng.choice([
            (np.nan, ANY), (-1.0, ANY), (np.ones(5), SAME), (np.ones(4), REFUSE), (np.ones((5, 1)), REFUSE), ("x", REFUSE),
            (None, REFUSE), ([], REFUSE), (1 + 2j, REFUSE), (np.array("a"), REFUSE), (object(), REFUSE), (10**400, REFUSE),
            (np.full(5, np.nan), ANY), (ad.Float([1.0] * 5), SAME), (ad.Float([1.0] * 4), REFUSE), (ad.Array3f(1), REFUSE),
            (np.ones(10)[::2], SAME), (np.ones(5, np.int32), SAME), (True, ANY), (np.array([], np.float32), REFUSE),
        ])  # fmt: skip
    arguments[key] = value
    if rng.random() < 0.3:
        arguments["precision"] = rng.choice(("float64", "float32", "float16", None, 32, ""))
        if arguments["precision"] not in ("float64", "float32", None):
            verdict = REFUSE

    def make() -> Any:
        ray = rt.Ray(**arguments)
        mesh = rt.TriangleMesh(VERTICES, FACES)
        precision = "float64" if dr.type_v(ray.o) == dr.VarType.Float64 else "float32"
        for kind in ("brute_force", "bvh"):
            structure = rt.accel.build(mesh, kind, precision=precision)
            hit = structure.intersect(ray)
            t, valid = np.array(hit.t), np.array(hit.valid)
            if np.isnan(t).any() or not np.isinf(t[~valid]).all() or not np.isfinite(t[valid]).all():
                raise Nonsense(f"Ray {key}={_shown(value)}: t = {t}")
            structure.occluded(ray)
            p = np.array(structure.interact(ray, hit).p)
            if not np.isfinite(p).all():
                raise Nonsense(f"Ray {key}={_shown(value)}: p = {p}")
        return ray

    return _checked(verdict, f"Ray {key}={_shown(value)} {arguments.get('precision', '')}", make, lambda _: True)


def _is_numeric(value: Any) -> bool:
    try:
        return (
            np.asarray(value).dtype.kind == "f" and np.asarray(value).shape[-1:] == (3,) and np.asarray(value).ndim <= 2
        )
    except ValueError:
        return False


def _scalar(rng: random.Random) -> tuple[Any, Verdict]:
    return rng.choice([
        (np.nan, REFUSE), (-1.0, REFUSE), (0.0, REFUSE), (-0.0, REFUSE), (np.inf, REFUSE), (-np.inf, REFUSE), ("1", REFUSE), (None, REFUSE),
        (1j, REFUSE), ([1.0, 2.0], REFUSE), (np.ones(3), REFUSE), (object(), REFUSE), (1e300, REFUSE), (1e-300, ANY), (10**400, REFUSE),
        (2, SAME), (np.float32(2), SAME), (np.int8(2), SAME), (np.array(2.0), SAME), (2.0, SAME), ("nan", REFUSE), (b"2", REFUSE),
        (1e-45, ANY), (1e-30, ANY), (1e20, ANY), (1e38, ANY), (True, ANY), ([], REFUSE), ({}, REFUSE),
    ])  # fmt: skip


def _sphere(rng: random.Random) -> Callable[[], None]:
    if rng.random() < 0.6:
        radius, verdict = _scalar(rng)
        name = f"Sphere.at radius={_shown(radius)}"
        return _checked(verdict, name, lambda: rt.Sphere.at((0, 0, 0), radius), lambda s: abs(s.radius - 2) < 1e-12)
    center, verdict = rng.choice([
        ((0, np.nan, 0), REFUSE), ((np.inf, 0, 0), REFUSE), ((1, 2), REFUSE), ("abc", REFUSE), (None, REFUSE), ((1, 2, 3, 4), REFUSE),
        (np.zeros((1, 3)), ANY), (np.zeros((3, 3)), REFUSE), (1.0, REFUSE), ((1j, 0, 0), REFUSE), ((1e300, 0, 0), REFUSE), ([], REFUSE),
        (np.array([1, 2, 3], ">f4"), SAME), ([1, 2, 3], SAME), (ad.Array3f(1, 2, 3), SAME), ((10**400, 0, 0), REFUSE), (object(), REFUSE),
    ])  # fmt: skip
    return _checked(
        verdict,
        f"Sphere.at center={_shown(center)}",
        lambda: rt.Sphere.at(center, 1.0),
        lambda s: np.allclose(s.center, [1, 2, 3]),
    )


def _matrix(rng: random.Random) -> tuple[Any, Verdict]:
    good = np.diag([2.0, 2.0, 2.0, 1.0])
    good[:3, 3] = (0, 0, 1)

    def at(i: int, j: int, value: float) -> np.ndarray:
        out = good.copy()
        out[i, j] = value
        return out

    mirrored = good.copy()
    mirrored[0] *= -1
    return rng.choice([
        (at(0, 3, np.nan), REFUSE), (at(1, 1, np.inf), REFUSE), (at(0, 0, 0.0), REFUSE), (at(3, 0, 1.0), REFUSE), (at(3, 3, 0.0), REFUSE),
        (at(3, 3, 2.0), REFUSE), (good[:3], REFUSE), (good[None], REFUSE), (np.zeros((4, 4)), REFUSE), (good.astype(str), REFUSE),
        ("x", REFUSE), (None, REFUSE), (good + 1j, REFUSE), (3.0, REFUSE), (object(), REFUSE), (at(0, 3, 1e300), REFUSE), (good.ravel(), REFUSE),
        (np.diag([1e300, 1e300, 1e300, 1]), REFUSE), (np.diag([1e-30, 1e-30, 1e-30, 1]), ANY), (np.diag([1e-310, 1e-310, 1e-310, 1]), ANY),
        (np.diag([1e20, 1e20, 1e20, 1]), ANY), (np.diag([1e38, 1e38, 1e38, 1]), ANY), (mirrored, ANY), (at(0, 1, 1e-3), ANY),
        (np.asfortranarray(good), SAME), (good.tolist(), SAME), (good.astype(">f8"), SAME), (good[::-1, ::-1][::-1, ::-1], SAME),
        (at(0, 0, 1e-200), ANY), ([[1, 2], [3]], REFUSE), (np.full((4, 4), "1"), REFUSE), (good.astype(object), SAME), ({}, REFUSE),
    ])  # fmt: skip


def _quadric(rng: random.Random) -> Callable[[], None]:
    kind = rng.choice((rt.Sphere, rt.Rectangle, rt.Disk, rt.Cylinder))
    matrix, verdict = _matrix(rng)
    good = np.diag([2.0, 2.0, 2.0, 1.0])
    good[:3, 3] = (0, 0, 1)
    name = f"{kind.__name__} to_world={_shown(matrix)}"
    return _checked(verdict, name, lambda: kind(matrix), lambda s: np.array_equal(s.to_world, good))


def _instance(rng: random.Random) -> Callable[[], None]:
    matrix, verdict = _matrix(rng)
    inner: Any = rt.accel.build(rt.TriangleMesh(VERTICES, FACES), rng.choice(("bvh", "grid", "kdtree")))
    if rng.random() < 0.2:
        inner, verdict = rng.choice((None, 3, rt.TriangleMesh(VERTICES, FACES), [inner], "bvh")), REFUSE
    name = f"Instance to_world={_shown(matrix)}"
    return _checked(verdict, name, lambda: rt.accel.build([rt.Instance(inner, matrix)]), lambda _: True)


def _build(rng: random.Random) -> Callable[[], None]:
    mesh = rt.TriangleMesh(VERTICES, FACES)
    kinds: list[tuple[Any, Verdict]] = [
        *[(k, SAME) for k in rt.accel.names()], ("bvh:width=2", SAME), ("bvh:builder=ploc,width=8", SAME), ("", REFUSE), ("BVH", REFUSE),
        ("bvh:", SAME), ("bvh:width", REFUSE), ("bvh:width=", REFUSE), ("bvh:width=3", REFUSE), ("bvh:width=2.0", ANY), ("bvh:width=nan", REFUSE),
        ("bvh:builder=x", REFUSE), ("bvh:max_leaf_size=0", REFUSE), ("bvh:max_leaf_size=-1", REFUSE), ("bvh:max_leaf_size=1e9", REFUSE),
        ("bvh:max_leaf_size=99999999999999999999", REFUSE), ("bvh:node_cost=nan", REFUSE), ("bvh:node_cost=inf", REFUSE),
        ("bvh:node_cost=-1", REFUSE), ("bvh:primitive_cost=0", REFUSE), ("bvh:geometry=1", REFUSE), ("bvh:__class__=1", REFUSE),
        ("bvh:reference_budget=1e30", REFUSE), ("brute_force:a=1", REFUSE), ("grid:density=nan", REFUSE), ("grid:density=1e30", ANY),
        ("grid:density=-1", REFUSE), ("grid:density=0", REFUSE), ("grid:x=1", REFUSE), ("kdtree:max_depth=-1", REFUSE),
        ("kdtree:max_depth=1e9", REFUSE), ("bsp:max_depth=nan", REFUSE), ("hierarchical_grid:levels=1000000", REFUSE), ("bvh:=1", REFUSE),
        ("bounding_volumes:volume=cube", REFUSE), ("bvh:width=1_0", REFUSE), (None, REFUSE), (3, REFUSE), (b"bvh", REFUSE), (["bvh"], REFUSE),
        ("bvh\0", REFUSE), ("bvh:width=2,width=4", ANY), ("bvh:width=2" * 1000, REFUSE), ("bvh:volume=sphere", SAME),
    ]  # fmt: skip
    kind, verdict = rng.choice(kinds)
    surfaces: Any = mesh
    precision: Any = "float32"
    if rng.random() < 0.25:
        surfaces, verdict = rng.choice((
            (None, REFUSE), (3, REFUSE), ([mesh, None], REFUSE), ("mesh", REFUSE), ([[mesh]], REFUSE), (rt.TriangleMesh, REFUSE),
            ([rt.accel.build(mesh, precision="float64")], REFUSE), (VERTICES, REFUSE), ([], ANY), ({}, ANY),
        ))  # fmt: skip
        kind = "bvh"
    elif rng.random() < 0.1:
        precision, verdict = rng.choice(("float16", None, 32, "double", "")), REFUSE
        kind = "bvh"

    def make() -> Any:
        structure = rt.accel.build(surfaces, kind, precision=precision)
        structure.intersect(rt.Ray([[0.1, 0.2, 4.0]], [[0.0, 0.0, -1.0]]))
        return structure

    def same(structure: Any) -> bool:
        t = np.array(structure.intersect(rt.Ray([[0.1, 0.2, 4.0]], [[0.0, 0.0, -1.0]])).t)
        return bool(np.allclose(t, 3.2, rtol=1e-6))

    return _checked(verdict, f"build {_shown(kind)} {_shown(surfaces)} {precision!r}", make, same)


def _hits(rng: random.Random) -> Callable[[], None]:
    """Hits that no query returned."""

    def call() -> None:
        members = [rt.TriangleMesh(VERTICES, FACES, uv=UV), rt.Sphere.at((3, 0, 0), 1.0)]
        group = rt.accel.build([rt.TriangleMesh(VERTICES, FACES)])
        items = members if rng.random() < 0.5 else [*members, rt.Instance(group, np.eye(4))]
        structure = rt.accel.build(items, rng.choice(("bvh", "grid", "brute_force")))
        ray = rt.Ray(np.zeros((8, 3)) + [0.1, 0.2, 4.0], [0, 0, -1])
        hit = structure.intersect(ray)
        key = rng.choice(("surface", "prim", "instance", "t", "uv"))
        numbers = (0, 1, 2, 3, 4, 100, 2**31 - 1, 2**31, 2**32 - 2, 2**32 - 1)
        if key in ("surface", "prim", "instance"):
            count = rng.choice((8, 8, 8, 1, 5, 0))
            setattr(hit, key, ad.UInt([rng.choice(numbers) for _ in range(count)]))
        elif key == "t":
            hit.t = ad.Float([rng.choice((np.nan, np.inf, -np.inf, -1.0, 1e38, 0.0)) for _ in range(8)])
        else:
            hit.uv = ad.Array2f([np.nan] * 8, [1e38] * 8)
        found = structure.interact(ray, hit)
        p, valid = np.array(found.p), np.array(found.valid)
        if key in ("surface", "prim", "instance") and not np.isfinite(p).all():
            raise Nonsense(f"interact with {key} of no hit: p = {p}")
        wrong = np.array(hit.surface) >= len(structure.geometry.surfaces)
        if key in ("surface", "prim", "instance") and valid.shape == wrong.shape and (valid & wrong).any():
            raise Nonsense("interact: a surface that is not there counts as met")

    return call


def _active(rng: random.Random) -> Callable[[], None]:
    structure = rt.accel.build(rt.TriangleMesh(VERTICES, FACES))
    ray: Any = rt.Ray(np.zeros((4, 3)) + [0.1, 0.2, 4.0], [0, 0, -1])
    active, verdict = rng.choice([
        (True, SAME), (False, ANY), (ad.Bool([True] * 4), SAME), (ad.Bool([True] * 3), REFUSE), (ad.Bool([]), REFUSE),
        (np.array([True] * 4), SAME), ([True] * 4, SAME), ("x", REFUSE), (None, REFUSE), (np.ones((2, 2), bool), REFUSE), (ad.Float(1), ANY),
        (np.array([True] * 3), REFUSE), (object(), REFUSE), (1, ANY),
    ])  # fmt: skip
    if rng.random() < 0.3:
        ray, verdict = rng.choice((None, 3, "x", [1, 2, 3], object(), np.zeros((3, 3)), rt.Ray)), REFUSE
        active = True
    query = rng.choice(("intersect", "occluded", "count"))
    target = structure if rng.random() < 0.5 or query == "count" else rt.TriangleMesh(VERTICES, FACES)

    def make() -> Any:
        return (
            dr.width(getattr(target, query)(ray, active))
            if query == "occluded"
            else getattr(target, query)(ray, active)
        )

    return _checked(verdict, f"{query} ray={_shown(ray)} active={_shown(active)}", make, lambda _: True)


def _render(rng: random.Random) -> Callable[[], None]:
    choices: list[tuple[dict[str, Any], Verdict]] = [
        ({}, SAME), ({"spp": -1}, REFUSE), ({"spp": 1.5}, REFUSE), ({"spp": "4"}, REFUSE), ({"spp": None}, REFUSE), ({"spp": np.nan}, REFUSE),
        ({"spp": 10**12}, REFUSE), ({"spp": 2**31}, REFUSE), ({"spp": 2**40}, REFUSE), ({"spp": np.int64(1)}, SAME), ({"spp": True}, ANY),
        ({"spp": 0}, ANY), ({"seed": -1}, ANY), ({"seed": 2**40}, ANY), ({"seed": 1.5}, REFUSE), ({"seed": "x"}, REFUSE), ({"seed": None}, REFUSE),
        ({"seed": np.nan}, REFUSE), ({"seed": 10**400}, ANY), ({"precision": "float16"}, REFUSE), ({"precision": None}, REFUSE),
        ({"precision": 64}, REFUSE), ({"precision": ["float32"]}, REFUSE), ({"accel": "nothing"}, REFUSE), ({"accel": ""}, ANY), ({"accel": 3}, REFUSE),
        ({"accel": "bvh:width=3"}, REFUSE), ({"accel": "bvh:max_leaf_size=99999"}, REFUSE), ({"accel": ["bvh"]}, REFUSE), ({"accel": b"bvh"}, REFUSE),
        ({"filter": "cubic"}, REFUSE), ({"filter": 3}, REFUSE), ({"filter": ["bilinear"]}, REFUSE), ({"sensor": 1}, REFUSE), ({"sensor": -1}, REFUSE),
        ({"sensor": 0.0}, REFUSE), ({"sensor": "0"}, REFUSE), ({"sensor": None}, REFUSE), ({"sensor": 2**70}, REFUSE), ({"size": (0, 4)}, REFUSE),
        ({"size": (-4, 4)}, REFUSE), ({"size": (4.5, 4)}, REFUSE), ({"size": (4,)}, REFUSE), ({"size": 4}, REFUSE), ({"size": "44"}, REFUSE),
        ({"size": (10**9, 10**9)}, REFUSE), ({"size": (10**9, 1)}, REFUSE), ({"size": (2**31, 1)}, REFUSE), ({"size": (60000, 17000)}, REFUSE),
        ({"size": (np.nan, 4)}, REFUSE), ({"size": (4, 4, 4)}, REFUSE), ({"size": (None, 4)}, REFUSE), ({"size": (np.int32(4), np.int64(4))}, SAME),
        ({"integrator": "volpath"}, REFUSE), ({"integrator": 3}, REFUSE), ({"integrator": ""}, REFUSE), ({"integrator": "direct"}, ANY),
        ({"integrator": {"type": "path"}}, REFUSE), ({"integrator": ["path"]}, REFUSE), ({"params": {}}, REFUSE), ({"progress": False}, SAME),
        ({"integrator": "aov"}, REFUSE),
    ]  # fmt: skip
    arguments, verdict = rng.choice(choices)
    if rng.random() < 0.15:
        scene, verdict = rng.choice((None, 3, "scene.xml", {}, rt.Scene, BASIC)), REFUSE
    else:
        scene = rt.load_string(BASIC)

    def make() -> Any:
        image = np.array(rt.render(scene, **{"size": (4, 4), **arguments}))
        if not np.isfinite(image).all():
            raise Nonsense(f"render {arguments}: pixels are not finite")
        return image

    return _checked(verdict, f"render {arguments}", make, lambda image: image.shape == (4, 4, 3))


def _load(rng: random.Random) -> Callable[[], None]:
    loader = rng.choice((rt.load_string, rt.load_file, rt.load_dict))
    value = rng.choice((
        None, 3, b"<scene/>", "", "\0", [], object(), "x" * 100_000, "/dev/zero", ".", "/", "http://example.org/s.xml", "a\0b.xml", {"type": None},
        {1: 2}, {"type": "scene", 3: {}}, {"type": "scene", "a": {}}, "\ud800",
    ))  # fmt: skip
    keywords: dict[str, Any] = {}
    if loader is rt.load_dict and rng.random() < 0.5:
        value = {"type": "scene"}
        keywords = {
            "settings": rng.choice((3, "x", {"accel": 3}, {"accel": None}, {1: 2}, {"accel": "nothing"}, [], {"a": 1}))
        }
    elif rng.random() < 0.4:
        value, loader = BASIC, rt.load_string
        keywords = {
            rng.choice(("x", "", "raytrace2.accel", "depth", "a b", "$")): rng.choice(
                (3, None, object(), "x" * 10000, "$x", [], np.nan)
            )
        }
    return lambda: None if loader(value, **keywords) else None


def _shown(value: Any) -> str:
    try:
        return " ".join(repr(value).split())[:100]
    except Exception:
        return type(value).__name__


_FAMILIES = (
    _mesh,
    _mesh,
    _ray,
    _ray,
    _sphere,
    _quadric,
    _instance,
    _build,
    _build,
    _hits,
    _active,
    _render,
    _render,
    _load,
)
