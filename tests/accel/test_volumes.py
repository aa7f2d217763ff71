"""Volumes hold what they are fitted to and are as small as they claim; groups lie together."""

import itertools

import drjit as dr
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raytrace2.accel import volume_groups
from raytrace2.accel.volumes import VOLUMES
from raytrace2.accel.volumes.box_axes import box_axes
from raytrace2.accel.volumes.enclosing_ball import enclosing_balls
from raytrace2.accel.volumes.hulls import Hulls
from raytrace2.surfaces.primitives import Primitives
from raytrace2.surfaces.quadrics import Sphere
from raytrace2.types import types


def hulls(*groups: np.ndarray, radii: np.ndarray | None = None) -> Hulls:
    sizes = [len(g) for g in groups]
    return Hulls(np.concatenate(groups).astype(float), radii, np.cumsum([0, *sizes[:-1]]))


def least_radius(points: np.ndarray) -> float:
    """Of the smallest enclosing ball, by trying the circumsphere of every subset of up to four points."""
    best = np.inf
    for k in (1, 2, 3, 4):
        for members in itertools.combinations(range(len(points)), k):
            p = points[list(members)]
            edges = p[1:] - p[0]
            offset = np.linalg.lstsq(2 * edges, np.square(edges).sum(axis=1), rcond=None)[0] if k > 1 else np.zeros(3)
            # Least squares gives the centre nearest to p[0], which lies in the plane of the points.
            best = min(best, np.linalg.norm(points - p[0] - offset, axis=1).max())
    return best


def test_balls_are_the_smallest():
    rng = np.random.default_rng(0)
    groups = [rng.normal(size=(n, 3)) * scale for n in (1, 2, 3, 4, 7, 9) for scale in (1, (1, 1, 0), (1, 0, 0))]
    groups += [np.round(rng.normal(size=(8, 3))) + 100 for _ in range(10)]
    groups += [np.repeat(rng.normal(size=(3, 3)), 3, axis=0), np.array(list(itertools.product((0, 1), repeat=3)))]
    h = hulls(*groups)
    radius = h.farthest(enclosing_balls(h))
    np.testing.assert_allclose(radius, [least_radius(g.astype(float)) for g in groups], rtol=1e-7, atol=1e-12)


def test_balls_of_many_points_touch_them_evenly():
    rng = np.random.default_rng(1)
    groups = [rng.normal(size=(300, 3)) for _ in range(20)]
    h = hulls(*groups)
    center = enclosing_balls(h)
    for c, g in zip(center, groups, strict=True):
        distance = np.linalg.norm(g - c, axis=1)
        touching = g[distance > distance.max() * (1 - 1e-7)] - c
        # The centre lies among the points on the ball: there is no direction that leaves all of them behind.
        assert 2 <= len(touching) <= 5
        directions = rng.normal(size=(2000, 3))
        assert ((directions @ touching.T).max(axis=1) > -1e-6 * distance.max()).all()


def test_oriented_boxes_find_the_axes_of_turned_boxes():
    rng = np.random.default_rng(2)
    corners = np.array(list(itertools.product((-1, 1), repeat=3)))
    groups, volumes = [], []
    for _ in range(50):
        q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        half = rng.uniform(0.1, 2, 3)
        inside = rng.uniform(-1, 1, (30, 3))
        groups.append((np.concatenate([corners, inside]) * half) @ q.T + rng.normal(size=3))
        volumes.append(half)
    words = VOLUMES["oriented_box"].fit(hulls(*groups), types("float64"))
    x, y, z = np.array(volumes).T * 2
    ratio = VOLUMES["oriented_box"].areas(words) / (2 * (x * y + y * z + z * x))
    assert (ratio > 0.999).all() and np.median(ratio) < 1.0001 and ratio.max() < 1.3


def test_oriented_boxes_are_never_larger_than_boxes_along_the_axes():
    rng = np.random.default_rng(3)
    groups = [rng.normal(size=(n, 3)) * rng.choice([0, 1e-3, 1], 3) for n in range(1, 40)]
    h = hulls(*groups)
    oriented, plain = (VOLUMES[k].areas(VOLUMES[k].fit(h, types("float64"))) for k in ("oriented_box", "box"))
    assert (oriented <= plain * (1 + 1e-9) + 1e-12).all()
    axes = box_axes(h)
    np.testing.assert_allclose(axes @ axes.transpose(0, 2, 1), np.broadcast_to(np.eye(3), axes.shape), atol=1e-12)


def meets(shape, words: np.ndarray, o: np.ndarray, d: np.ndarray, precision, tmin=0.0, tmax=1e30) -> np.ndarray:
    """Whether ray k meets volume k."""
    t = types(precision)
    volume = VOLUMES[shape]

    class Given:
        pass

    ray = Given()
    ray.o, ray.d = (t.Array3f(v.T.astype(t.numpy)) for v in (o, d))
    ray.tmin, ray.tmax = t.Float(tmin), t.Float(tmax)
    columns = [t.Float(np.ascontiguousarray(c)) for c in words.T]
    return volume.meets(columns, volume.prepare(ray, t), ray.tmax).numpy()


numbers = st.floats(-1, 1, width=32)
few_points = st.lists(st.tuples(numbers, numbers, numbers), min_size=1, max_size=6)


@pytest.mark.parametrize("precision", ["float32", "float64"])
@settings(max_examples=12, deadline=None, derandomize=True)
@given(few_points, st.sampled_from([1e-20, 1e-6, 1.0, 1e6, 1e20]), st.sampled_from([0.0, 1.0, 1e4]))
def test_rays_to_points_inside_meet_the_volume(precision, points, scale, shift):
    t = types(precision)
    group = ((np.array(points) + shift) * scale).astype(t.numpy).astype(float)
    rng = np.random.default_rng(0)
    n = 90
    # Vertices, and points between them that are met from so far away that their own rounding does not matter.
    between = rng.dirichlet(np.ones(len(group)), n) @ group
    target = np.where(np.arange(n)[:, None] % 3, group[rng.integers(0, len(group), n)], between)
    away = scale * 10.0 ** rng.uniform(-3, 4, (n, 1))
    away = np.where(np.arange(n)[:, None] % 3, away, away + np.abs(target).max())
    o = (target + rng.normal(size=(n, 3)) * away).astype(t.numpy).astype(float)
    o[1::9] = target[1::9]
    d = np.where((o == target).all(axis=1, keepdims=True), rng.normal(size=(n, 3)), target - o)
    for shape in VOLUMES:
        words = VOLUMES[shape].fit(hulls(group), t)
        found = meets(shape, np.repeat(words, n, axis=0), o, d, precision)
        assert found.all(), (shape, np.flatnonzero(~found))


def test_rays_that_pass_or_end_before_are_let_go():
    rng = np.random.default_rng(4)
    group = rng.uniform(-1, 1, (20, 3))
    n = 500
    away = rng.normal(size=(n, 3))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    o = away * 4
    for shape in VOLUMES:
        words = np.repeat(VOLUMES[shape].fit(hulls(group), types("float32")), n, axis=0)
        assert not meets(shape, words, o, away, "float32").any()
        assert not meets(shape, words, o, -away, "float32", tmax=1.5).any()
        assert not meets(shape, words, o, -away, "float32", tmin=8.0).any()
        assert meets(shape, words, o, -away, "float32").all()
        across = np.cross(away, rng.normal(size=(n, 3)))
        assert not meets(shape, words, o, across, "float32").any()


def test_volumes_around_spheres_use_their_round_shape():
    parts = Primitives.join([Sphere.at((k, 0, 0), 0.5).primitives(types("float32"), k) for k in range(2)])
    h = Hulls.of(parts, np.array([0, 1, 2]))
    radius = VOLUMES["sphere"].fit(h, types("float32"))[:, 3]
    assert ((radius >= 0.5) & (radius < 0.5001)).all()
    both = VOLUMES["sphere"].fit(Hulls.of(parts, np.array([0, 2])), types("float32"))
    assert 1 <= both[0, 3] < 1.001
    oriented = VOLUMES["oriented_box"].fit(h, types("float32"))[:, 12:15]
    assert ((oriented >= 0.5) & (oriented < 0.501)).all()


def test_groups_hold_everything_once_and_lie_together():
    rng = np.random.default_rng(5)
    lo = rng.uniform(size=(1000, 3))
    found = volume_groups.halved(lo, lo + 0.01, 8)
    for groups in found:
        np.testing.assert_array_equal(np.sort(groups.order), np.arange(1000))
    assert np.diff(found[-1].firsts).max() <= 8 and np.diff(found[-1].firsts).min() >= 7
    tests = [volume_groups.expected_tests(g, lo, lo + 0.01) for g in found]
    assert tests[0] == 1000 and all(np.diff(tests) < 0)
    shuffled = volume_groups.Groups(rng.permutation(1000), found[-1].firsts)
    assert tests[-1] < volume_groups.expected_tests(shuffled, lo, lo + 0.01) / 10


def test_a_few_large_primitives_stand_apart():
    rng = np.random.default_rng(6)
    lo = rng.uniform(size=(200, 3))
    hi = lo + 0.01
    lo[[7, 90]], hi[[7, 90]] = -1, (2, 2, -0.9)
    large = volume_groups.few_large(lo, hi)
    assert np.flatnonzero(large).tolist() == [7, 90]
    groups = volume_groups.with_singles(volume_groups.halved(lo[~large], hi[~large], 16)[-1], large)
    np.testing.assert_array_equal(np.sort(groups.order), np.arange(200))
    assert groups.order[-2:].tolist() == [7, 90] and np.diff(groups.firsts)[-2:].tolist() == [1, 1]
    mixed = volume_groups.halved(lo, hi, 16)[-1]
    assert volume_groups.expected_tests(groups, lo, hi) < volume_groups.expected_tests(mixed, lo, hi) / 2
    assert not volume_groups.few_large(lo[:8], hi[:8]).any()
    nothing = np.zeros((40, 3))
    assert not volume_groups.few_large(nothing, nothing).any()


def test_the_test_of_a_ball_takes_no_square_root():
    """Balls are asked whether, not where."""
    t = types("float32")
    words = np.repeat(VOLUMES["sphere"].fit(hulls(np.eye(3)), t), 4, axis=0)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        meets("sphere", words, np.zeros((4, 3)), np.ones((4, 3)), "float32")
        text = "".join(entry["ir"].getvalue() for entry in dr.kernel_history() if "ir" in entry)
    assert "fmul" in text and "sqrt" not in text
