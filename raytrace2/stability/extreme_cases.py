"""Scenes and rays that ask for more work than they seem to: each is timed beside a benign one of its size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..surfaces.mesh import TriangleMesh
from ..surfaces.surface import Surface
from .meshes import Closed, icosphere
from .rays import from_inside


@dataclass(frozen=True, eq=False)
class Case:
    """Surfaces with about as many triangles as the benign scene beside it, and rays ``o``, ``d`` (n, 3)."""

    surfaces: tuple[Surface, ...]
    o: np.ndarray
    d: np.ndarray


Make = Callable[[Closed, np.ndarray, np.ndarray, np.random.Generator], Case]


def benign(closed: Closed, o: np.ndarray, d: np.ndarray, _: np.random.Generator) -> Case:
    """Random rays in the icosphere: the measure of what moves or scales it, and of odd rays."""
    return Case((closed.mesh,), o, d)


def random_triangles(closed: Closed, o: np.ndarray, d: np.ndarray, rng: np.random.Generator) -> Case:
    """The same rays among triangles anywhere in the unit ball, so large that all but 2 % meet one: the measure of other
    scenes of as many triangles."""
    count = len(closed.faces)
    middle = rng.normal(size=(count, 1, 3))
    middle *= np.cbrt(rng.random((count, 1, 1))) / np.linalg.norm(middle, axis=2, keepdims=True)
    # Triangles with normally distributed corners have an area of 1.4 in the mean or so; 4 are met on the way out.
    size = np.sqrt(8 * (4 / 3 * np.pi) / (1.4 * count))
    at = (middle + size * rng.normal(size=(count, 3, 3))).reshape(-1, 3)
    return Case((TriangleMesh(at, np.arange(3 * count).reshape(-1, 3)),), o, d)


def rays_for(levels: int, dtype: str, count: int, seed: int) -> tuple[Closed, np.ndarray, np.ndarray]:
    """The benign mesh and rays."""
    closed = icosphere(levels, dtype)
    rays = from_inside(closed, "random", count, np.random.default_rng(seed))
    return closed, rays.o, rays.d


def _scaled(exponent: int) -> Make:
    def make(closed: Closed, o: np.ndarray, d: np.ndarray, _: np.random.Generator) -> Case:
        return Case((closed.placed(2.0**exponent).mesh,), o * 2.0**exponent, d)

    return make


def _moved(closed: Closed, o: np.ndarray, d: np.ndarray, _: np.random.Generator) -> Case:
    return Case((closed.placed(1, 1e6).mesh,), o + 1e6, d)


def _from_afar(closed: Closed, o: np.ndarray, d: np.ndarray, _: np.random.Generator) -> Case:
    return Case((closed.mesh,), o - 1e6 * d.astype(np.float64), d)


def _along_axes(closed: Closed, o: np.ndarray, d: np.ndarray, rng: np.random.Generator) -> Case:
    zeros = rng.choice([0.0, -0.0], d.shape)
    zeros[np.arange(len(d)), rng.integers(0, 3, len(d))] = rng.choice([-1.0, 1.0], len(d))
    return Case((closed.mesh,), o, zeros)


def _denormal(closed: Closed, o: np.ndarray, d: np.ndarray, rng: np.random.Generator) -> Case:
    tiny = float(np.finfo(closed.dtype).smallest_subnormal)
    return Case((closed.mesh,), o, np.where(rng.random(d.shape) < 0.5, tiny, d * 1e-30))


def _no_numbers(closed: Closed, o: np.ndarray, d: np.ndarray, rng: np.random.Generator) -> Case:
    bad = rng.choice([np.nan, np.inf, -np.inf, 1.0], o.shape)
    return Case((closed.mesh,), np.where(rng.random((len(o), 1)) < 0.5, o, bad), np.where(np.isfinite(bad), d, bad))


def _needles(closed: Closed, o: np.ndarray, d: np.ndarray, _: np.random.Generator) -> Case:
    stretch = np.array([1e6, 1.0, 1.0])
    return Case((TriangleMesh(closed.vertices * stretch, closed.faces),), o * stretch, d)


def _flat(closed: Closed, o: np.ndarray, d: np.ndarray, rng: np.random.Generator) -> Case:
    """Everything in one plane, rays within it."""
    flat = np.array([1.0, 1.0, 0.0])
    within = d * flat + rng.choice([0.0, 1e-30], (len(d), 1)) * (1 - flat)
    return Case((TriangleMesh(closed.vertices * flat, closed.faces),), o * flat * 3, within)


def _no_area(closed: Closed, o: np.ndarray, d: np.ndarray, _: np.random.Generator) -> Case:
    return Case((TriangleMesh(closed.vertices, closed.faces[:, [0, 1, 1]]),), o, d)


def _stadium(closed: Closed, o: np.ndarray, d: np.ndarray, _: np.random.Generator) -> Case:
    """Everything in a millionth of the extent of one triangle."""
    small = TriangleMesh(closed.vertices * 1e-6, closed.faces)
    return Case((small, TriangleMesh([[-1, -1, -1], [1, -1, -1], [0, 1, -1]], [[0, 1, 2]])), o * 1e-6, d)


def _one_centroid(closed: Closed, o: np.ndarray, d: np.ndarray, rng: np.random.Generator) -> Case:
    """Triangles of all sizes and turns about one point; their boxes cannot be told apart by their middles."""
    count = len(closed.faces)
    corner = rng.normal(size=(count, 2, 3))
    third = -corner.sum(axis=1, keepdims=True)
    size = 10.0 ** rng.uniform(-6, 0, (count, 1, 1))
    at = (np.concatenate([corner, third], axis=1) * size).reshape(-1, 3)
    return Case((TriangleMesh(at, np.arange(3 * count).reshape(-1, 3)),), o + 3 * d.astype(np.float64), -d)


def _identical(closed: Closed, o: np.ndarray, d: np.ndarray, rng: np.random.Generator) -> Case:
    """The same triangle over and over; half of the rays go past it."""
    at = np.array([[-1.0, -1.0, 0.1], [1.0, -1.0, 0.0], [0.0, 1.0, -0.1]])
    target = rng.uniform(-1, 1, o.shape) * [1.5, 1.5, 0.0]
    start = np.array([0.3, 0.2, 3.0]) + 0.1 * o
    return Case((TriangleMesh(at, np.tile([[0, 1, 2]], (len(closed.faces), 1))),), start, target - start)


#: Cases that are other scenes than the icosphere: beside random triangles.
OTHER_SCENES = ("all in one plane, rays within", "one centroid for all", "identical triangles")

CASES: dict[str, Make] = {
    "scale 2^-60": _scaled(-60),
    "scale 2^60": _scaled(60),
    "translation 1e6": _moved,
    "rays from 1e6 radii away": _from_afar,
    "rays along axes, zeros of both signs": _along_axes,
    "denormal and tiny directions": _denormal,
    "infinite and NaN rays": _no_numbers,
    "stretched 1e6 : 1": _needles,
    "all in one plane, rays within": _flat,
    "triangles without area": _no_area,
    "all in 1e-6 of the extent": _stadium,
    "one centroid for all": _one_centroid,
    "identical triangles": _identical,
}
