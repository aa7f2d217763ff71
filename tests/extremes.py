"""A grammar of extremes: numbers, meshes and rays where renderers go wrong, as tables and as hypothesis strategies.

Meshes are (vertices (n, 3) float64, faces (m, 3) int); rays are (o, d, tmin, tmax) of NumPy arrays. Everything is made
in float64 about the unit cube; :func:`moved` brings meshes and rays to a scale and an offset.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from hypothesis import strategies as st

from raytrace2.surfaces.quadrics import Cylinder, Disk, Rectangle, Sphere

Mesh = tuple[np.ndarray, np.ndarray]
Rays = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]

#: Powers of two that whole scenes are multiplied by.
SCALES = tuple(2.0**k for k in (-60, -30, -10, 0, 10, 30, 60))

#: How far from the origin a scene of unit size lies.
OFFSETS = (0.0, 1.0, 1e2, 1e4, 1e6, 1e7)

#: Direction components; the last two are subnormal in float32 and in float64.
COMPONENTS = (0.0, -0.0, 1.0, -1.0, 1e-8, -1e-20, 1e-30, 1e30, 1e-40, 5e-324)

#: No rays can have these.
NO_NUMBERS = (np.nan, np.inf, -np.inf)

#: Indices of refraction, inner over outer: none, next to none, glass, diamond, and the way out.
INDEX_RATIOS = (1.0, 1 + 2.0**-23, 1 - 2.0**-24, 1.0001, 1.5, 2.42, 1 / 1.5)

#: Cosines of grazing incidence.
GRAZING = (0.0, 1e-30, 1e-12, 1e-6, 1e-3)

#: Ratios of the axes of texture footprints.
ANISOTROPIES = (1.0, 1e3, 1e6, 1e9)

#: Points of the unit sphere where its parameterisation is singular: poles, and the seam of uv from either side.
POLES_AND_SEAMS = ((0, 0, 1), (0, 0, -1), (1, 0, 0), (1, 1e-20, 0), (1, -1e-20, 0), (0.6, 0.0, 0.8), (0.6, -0.0, 0.8))


def critical_angle_cosine(ratio: float) -> float:
    """The cosine beyond which light inside a medium of that index ratio (over 1) is all reflected."""
    return float(np.sqrt(1 - 1 / ratio**2))


def sheet(n: int = 6) -> Mesh:
    """A flat box: n x n squares in the plane z = 0.25, edges along the axes."""
    x, y = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), indexing="ij")
    k = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = np.concatenate([np.stack([k, k + n + 1, k + 1], 1), np.stack([k + 1, k + n + 1, k + n + 2], 1)])
    return np.stack([x, y, np.full_like(x, 0.25)], -1).reshape(-1, 3), faces


def tetrahedron() -> Mesh:
    """Four faces that share every edge and corner."""
    return np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float), np.array(
        [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    )


def fan(n: int = 24) -> Mesh:
    """n triangles about one vertex, a cone: rays through it are shared by all."""
    angle = np.arange(n) * 2 * np.pi / n
    rim = np.stack([0.5 + 0.5 * np.cos(angle), 0.5 + 0.5 * np.sin(angle), 0 * angle], 1)
    k = np.arange(n)
    return np.concatenate([[[0.5, 0.5, 0.3]], rim]), np.stack([0 * k, 1 + k, 1 + (k + 1) % n], 1)


def slivers(rng: np.random.Generator, n: int = 24) -> Mesh:
    """Triangles whose third vertex lies next to the edge between the others, at a distance of 1e-2 to 1e-12 of it."""
    a, b = rng.random((2, n, 3))
    off = rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(-12, -2, (n, 1))
    return _soup(a, b, a + (b - a) * rng.random((n, 1)) + off)


def needles(rng: np.random.Generator, n: int = 24) -> Mesh:
    """Triangles with one edge 1e3 to 1e9 times shorter than the others."""
    a, b = rng.random((2, n, 3))
    return _soup(a, b, b + rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(-9, -3, (n, 1)))


def no_area(rng: np.random.Generator, n: int = 24) -> Mesh:
    """Points, lines with a vertex twice and lines of three points, among triangles that share their edges."""
    a, b, c = rng.random((3, n, 3))
    vertices = np.concatenate([a, b, c, (a + b) / 2])
    k = np.arange(n)
    lines = np.stack([k, k + n, k + np.where(k % 2, n, 3 * n)], 1)
    return vertices, np.concatenate([np.stack([k, k + n, k + 2 * n], 1), lines, np.stack([k, k, k], 1)])


def duplicates(rng: np.random.Generator, n: int = 8) -> Mesh:
    """Each triangle six times: as it is, turned, and wound the other way, with its own vertices or with shared ones."""
    vertices, faces = _soup(*rng.random((3, n, 3)))
    faces = np.concatenate([faces, faces[:, [1, 2, 0]], faces[:, ::-1]])
    return np.concatenate([vertices, vertices]), np.concatenate([faces, faces + len(vertices)])


def one_centroid(rng: np.random.Generator, n: int = 80) -> Mesh:
    """Triangles of many sizes whose boxes all have the same middle."""
    corner = rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(-4, 0, (n, 1))
    side = rng.uniform(-1, 1, (n, 3)) * corner
    return _soup(0.5 + corner, 0.5 - corner, 0.5 + side)


def coincident(n: int = 200) -> Mesh:
    """The same triangle n times."""
    return np.array([[0, 0, 0.5], [1, 0, 0.5], [0, 1, 0.6]]), np.tile([[0, 1, 2]], (n, 1))


def teapot_in_a_stadium(rng: np.random.Generator, n: int = 60) -> Mesh:
    """Small triangles in a millionth of the extent of a large one."""
    small, faces = _soup(*(0.5 + 1e-6 * rng.normal(size=(3, n, 3))))
    return np.concatenate([small, [[0, 0, 0], [1, 0, 0], [0, 1, 1]]]), np.concatenate([faces, faces[-1:] + 3])


MESHES: dict[str, Callable[[np.random.Generator], Mesh]] = {
    "flat sheet": lambda _: sheet(),
    "tetrahedron": lambda _: tetrahedron(),
    "fan": lambda _: fan(),
    "slivers": slivers,
    "needles": needles,
    "no area": no_area,
    "duplicates": duplicates,
    "one centroid": one_centroid,
    "coincident": lambda _: coincident(),
    "teapot in a stadium": teapot_in_a_stadium,
}


def quadrics(scale: float = 1.0, offset: float = 0.0) -> list[Any]:
    """Spheres large and small, and flat and round things as thin as a millionth."""

    def placed(size: tuple[float, float, float], at: float) -> np.ndarray:
        matrix = np.diag([*(scale * s for s in size), 1.0])
        matrix[:3, 3] = scale * at + offset
        return matrix

    return [
        Sphere(placed((0.3, 0.3, 0.3), 0.5)),
        Sphere(placed((1e-4, 1e-4, 1e-4), 0.1)),
        Sphere(placed((1e3, 1e3, 1e3), -600)),
        Disk(placed((0.5, 1e-6, 1), 0.3)),
        Rectangle(placed((1e-6, 0.5, 1), 0.6)),
        Cylinder(placed((1e-5, 1e-5, 1), 0.4)),
    ]


def rays(rng: np.random.Generator, mesh: Mesh, n: int = 400) -> Rays:
    """About ``n`` rays for a mesh: through its vertices and shared edges, along edges, in the planes of faces, along
    axes with zeros of both signs, tiny and huge directions, from on the surface, inside and far away, with tmin or tmax
    at a target, and a few that are no rays at all."""
    vertices, faces = mesh
    m = n // 10
    corner = vertices[faces[rng.integers(0, len(faces), m)]]
    weight = rng.dirichlet([1, 1, 1], m)
    weight[: m // 3, 2] = 0  # on an edge
    weight[: m // 6, 1] = 0  # on a vertex
    weight /= weight.sum(axis=1, keepdims=True)
    target = (corner * weight[:, :, None]).sum(axis=1)
    reach = np.ptp(vertices, axis=0).max()
    near = 0.5 + rng.uniform(-1.5, 1.5, (m, 3)) * reach
    far = 0.5 + 1e6 * rng.normal(size=(m, 3)) * reach
    axis = rng.choice([0.0, -0.0], (m, 3))
    axis[np.arange(m), rng.integers(0, 3, m)] = rng.choice([-1.0, 1.0], m)
    in_plane = (corner[:, 1] - corner[:, 0]) * rng.normal(size=(m, 1)) + corner[:, 2] - corner[:, 0]
    odd = rng.choice(COMPONENTS, (m, 3))
    bad = rng.choice([*NO_NUMBERS, 1.0, 0.0], (m, 3))
    pairs = [
        (near, target - near),
        (far, target - far),
        (target, rng.normal(size=(m, 3))),
        (target - 2 * axis, axis),
        (corner[:, 0] - 0.5 * (corner[:, 1] - corner[:, 0]), corner[:, 1] - corner[:, 0]),
        (target - in_plane, in_plane),
        (target - odd * 1e-3, odd),
        (near, bad),
        (bad, target - near),
    ]
    o = np.concatenate([p[0] for p in pairs] + [near])
    d = np.concatenate([p[1] for p in pairs] + [target - near])
    # Of the first and the last, t is 1 at the target.
    tmin, tmax = np.zeros(len(o)), np.full(len(o), np.inf)
    tmin[-m:] = rng.choice([1.0, 0.0, -1.0, np.nextafter(1, 2), np.inf, np.nan, -np.inf], m)
    tmax[-m:] = rng.choice([1.0, 0.0, -1.0, np.nextafter(1, 0), np.inf, np.nan, 1e38], m)
    return o, d, tmin, tmax


def are_rays(o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """(n,) bool: which of these have finite numbers throughout and a direction."""
    return np.isfinite(o).all(axis=1) & np.isfinite(d).all(axis=1) & (d != 0).any(axis=1)


def moved(mesh: Mesh, found: Rays, scale: float, offset: float) -> tuple[Mesh, Rays]:
    """Mesh and rays times ``scale``, then ``offset`` added: the same t at the same points."""
    (vertices, faces), (o, d, tmin, tmax) = mesh, found
    with np.errstate(over="ignore", invalid="ignore"):
        return (vertices * scale + offset, faces), (o * scale + offset, d * scale, tmin, tmax)


def _soup(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> Mesh:
    return np.stack([a, b, c], 1).reshape(-1, 3), np.arange(3 * len(a)).reshape(-1, 3)


scales = st.integers(-60, 60).map(lambda k: 2.0**k)
offsets = st.one_of(st.sampled_from(OFFSETS), st.floats(0, 7).map(lambda e: 10.0**e))
components = st.one_of(st.sampled_from(COMPONENTS), st.floats(-1, 1))
directions = st.tuples(components, components, components).map(np.array)
generators = st.integers(0, 2**32 - 1).map(np.random.default_rng)


@st.composite
def meshes(draw: st.DrawFn) -> Mesh:
    """One of the meshes of the table, drawn at random."""
    return MESHES[draw(st.sampled_from(sorted(MESHES)))](draw(generators))


@st.composite
def scenes(draw: st.DrawFn) -> tuple[Mesh, Rays]:
    """A mesh and rays for it, at some scale or at some offset, as rounded to no precision yet."""
    mesh = draw(meshes())
    found = rays(draw(generators), mesh)
    if draw(st.booleans()):
        return moved(mesh, found, draw(scales), 0.0)
    return moved(mesh, found, 1.0, draw(offsets))
