"""Structures over structures, written as nested calls of ``build``, and rays that find where they would go wrong."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import agreement_cases
import drjit as dr
import numpy as np

from raytrace2 import accel
from raytrace2.rays.ray import Ray
from raytrace2.surfaces.instance import Instance
from raytrace2.surfaces.mesh import TriangleMesh
from raytrace2.surfaces.structure import Structure
from raytrace2.surfaces.surface import Surface

Items = Sequence[Surface]
Build = Callable[[Items, str], Structure]

FIELDS = ("t", "prim", "surface", "instance", "uv", "occluded")


def _place(turn: float, scale: float, shift: tuple[float, float, float], mirrored: bool = False) -> np.ndarray:
    c, s = np.cos(turn), np.sin(turn)
    result = np.eye(4)
    result[:3, :3] = scale * np.array([[c, -s, 0], [s, c, 0], [0, 0, -1.0 if mirrored else 1.0]])
    result[:3, 3] = shift
    return result


#: Where instances stand: as it is, turned and smaller, mirrored, and twice in the same place.
PLACES = (
    np.eye(4),
    _place(0.7, 0.5, (0.8, -0.3, 0.4)),
    _place(2.0, 1.5, (-0.5, 0.6, -0.2), mirrored=True),
    np.eye(4),
)


@dataclass(frozen=True)
class Combination:
    """``make`` builds it from surfaces with a given ``build``; ``places``: where copies of the surfaces are."""

    make: Callable[[Build, Items], Structure]
    places: tuple[np.ndarray, ...] = ()

    def structure(self, items: Items, precision: str) -> Structure:
        return self.make(lambda inner, kind: accel.build(inner, kind, precision=precision), items)

    def reference(self, structure: Structure, items: Items) -> Structure:
        """What tests every primitive, and numbers them as ``structure`` does."""
        precision = structure.types.precision
        if self.places:
            return self.make(lambda inner, _: accel.build(inner, "brute_force", precision=precision), items)
        return accel.build(structure.geometry.surfaces, "brute_force", precision=precision)


def pieces(items: Items, count: int) -> list[list[Surface]]:
    """The same surfaces in ``count`` groups, of which some may be empty: meshes cut into slabs along x."""
    found: list[list[Surface]] = [[] for _ in range(count)]
    others = 0
    for item in items:
        if isinstance(item, TriangleMesh):
            order = np.argsort(item.vertices[item.faces][:, :, 0].mean(axis=1), kind="stable")
            for group, some in zip(found, np.array_split(order, count), strict=True):
                if len(some):
                    group.append(TriangleMesh(item.vertices, item.faces[np.sort(some)]))
        else:
            found[others % count].append(item)
            others += 1
    return found


def combinations() -> dict[str, Combination]:
    """Every structure that ``names()`` has and what can be made of them, by name: A(B) is an A over several B."""
    kinds = accel.names()
    found = {kind: Combination(lambda build, items, kind=kind: build(items, kind)) for kind in (*kinds, *_variants())}
    for outer in kinds:
        for inner in kinds:
            found[f"{outer}({inner})"] = Combination(
                lambda build, items, a=outer, b=inner: build([build(part, b) for part in pieces(items, 2)], a)
            )
    for outer in kinds:
        found[f"{outer}(every kind)"] = Combination(
            lambda build, items, a=outer: build(
                [build(part, b) for part, b in zip(pieces(items, len(kinds)), kinds, strict=True)], a
            )
        )
        found[f"{outer}(loose, bvh)"] = Combination(lambda build, items, a=outer: _half_loose(build, items, a, "bvh"))
        found[f"bvh(instances of {outer})"] = Combination(
            lambda build, items, b=outer: build([Instance(build(items, b), m) for m in PLACES], "bvh"), PLACES
        )
        found[f"{outer}(instances of bvh)"] = Combination(
            lambda build, items, a=outer: build(_instances(build(items, "bvh")), a), PLACES
        )
    for outer, middle, inner in _triples(kinds):
        found[f"{outer}({middle}({inner}))"] = Combination(
            lambda build, items, a=outer, b=middle, c=inner: build(
                [build([build(part, c) for part in pieces(half, 2)], b) for half in pieces(items, 2)], a
            )
        )
    return found | _by_hand()


def _variants() -> list[str]:
    """Settings that make another walk or another tree of a kind."""
    builders = ("median", "middle", "sweep", "morton", "ploc", "spatial")
    return [
        *(f"bvh:builder={b}" for b in builders),
        *("bvh:width=2", "bvh:width=8", "bvh:volume=sphere", "bvh:volume=oriented_box", "bvh:max_leaf_size=1"),
        *("bounding_volumes:volume=sphere", "bounding_volumes:volume=oriented_box", "bounding_volumes:group_size=3"),
        *("grid:density=0.2", "hierarchical_grid:levels=3"),
    ]


def _triples(kinds: Sequence[str]) -> list[tuple[str, str, str]]:
    """Three levels, of which every kind is each once."""
    n = len(kinds)
    return [(kinds[k], kinds[(k + 1) % n], kinds[(k + 3) % n]) for k in range(n)]


def _half_loose(build: Build, items: Items, outer: str, inner: str) -> Structure:
    loose, rest = pieces(items, 2)
    return build([*loose, build(rest, inner)], outer)


def _instances(structure: Structure) -> list[Surface]:
    return [Instance(structure, m) for m in PLACES]


def _by_hand() -> dict[str, Combination]:
    """Combinations that a user would write, and options that only matter when there is something inside."""
    return {
        "boxes of bvhs, one each": Combination(
            lambda build, items: build(
                [build(part, "bvh") for part in pieces(items, 5)], "bounding_volumes:group_size=surface"
            )
        ),
        "balls of grids": Combination(
            lambda build, items: build(
                [build(part, "grid") for part in pieces(items, 3)], "bounding_volumes:volume=sphere,group_size=1"
            )
        ),
        "turned boxes in a bvh of grids": Combination(
            lambda build, items: build([build(part, "grid") for part in pieces(items, 3)], "bvh:volume=oriented_box")
        ),
        "narrow bvh of wide bvhs": Combination(
            lambda build, items: build([build(part, "bvh:width=8") for part in pieces(items, 3)], "bvh:width=2")
        ),
        "a grid in a grid in a grid in a grid": Combination(
            lambda build, items: build([build([build([build(items, "grid")], "grid")], "grid")], "grid")
        ),
        "instances of a grid of grids, in a grid": Combination(
            lambda build, items: build(
                _instances(build([build(part, "grid") for part in pieces(items, 2)], "grid")), "grid"
            ),
            PLACES,
        ),
        "instances of two kinds and what is loose": Combination(
            lambda build, items: build(
                [*items, *_instances(build(items, "grid")), *_instances(build(items, "bvh:width=2"))], "bvh"
            ),
            PLACES,
        ),
        "a bvh of instances beside a bvh, in boxes": Combination(
            lambda build, items: build(
                [build(_instances(build(items, "bvh")), "bvh"), build(items, "bvh:width=8")], "bounding_volumes"
            ),
            PLACES,
        ),
    }


def hard_rays(combination: Combination, structure: Structure, points: np.ndarray, n: int, seed: int = 1) -> Ray:
    """About ``n`` rays: three quarters at, from and along ``points``, wherever copies of the surfaces have them, the
    rest in the planes of splits and walls, along their edges, from their corners and at them."""
    rng = np.random.default_rng(seed)
    copies = [points @ m[:3, :3].T + m[:3, 3] for m in combination.places]
    precision = structure.types.precision
    ray = agreement_cases.rays(rng, np.concatenate([points, *copies]), n - n // 4, precision)
    o, d = _wall_rays(structure, rng, n // 4)
    many = len(o)
    tmin, tmax = (np.concatenate([np.array(v), np.full(many, x)]) for v, x in ((ray.tmin, 0.0), (ray.tmax, np.inf)))
    return Ray(np.vstack([np.array(ray.o).T, o]), np.vstack([np.array(ray.d).T, d]), tmin, tmax, precision=precision)


def _wall_rays(structure: Structure, rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    lo, hi = _cells(structure)
    low, high = lo.min(axis=0), hi.max(axis=0)
    reach = max(float((high - low).max()), 1e-3)
    m, rows = max(n // 4, 1), np.arange(max(n // 4, 1))

    def corners() -> np.ndarray:
        k = rng.integers(0, len(lo), m)
        return np.where(rng.uniform(size=(m, 3)) < 0.5, lo[k], hi[k])

    axis = rng.integers(0, 3, m)
    in_plane, within = rng.uniform(low, high, (m, 3)), rng.normal(size=(m, 3))
    in_plane[rows, axis] = corners()[rows, axis]
    within[rows, axis] = rng.choice([0.0, -0.0], m)
    along = np.zeros((m, 3))
    along[rows, axis] = rng.choice([-1.0, 1.0], m)
    # From on the edge, or from outside.
    on_edge = corners() - along * rng.choice([0.0, 2.0], (m, 1)) * reach
    outside = rng.uniform(-1.5, 1.5, (m, 3)) * reach + (low + high) / 2
    o = np.concatenate([in_plane, on_edge, corners(), outside])
    d = np.concatenate([within, along, rng.normal(size=(m, 3)), corners() - outside])
    d[(d == 0).all(axis=1)] = 1.0
    return o, d


def _cells(structure: Structure) -> tuple[np.ndarray, np.ndarray]:
    """The boxes of a structure and of those in it."""
    found = [(np.zeros((0, 3)), np.zeros((0, 3))), *structure.level_bounds()]
    parts = structure.geometry.primitives()
    if parts is not None:
        found.append((parts.lo, parts.hi))
        found += [_cells(inner) for inner in parts.nested if isinstance(inner, Structure)]
    resolution = structure.statistics().get("resolution")
    if resolution is not None:
        lo, hi = structure.bounds()
        # All cells of a small grid, and enough of a large one.
        k = np.stack(np.meshgrid(*[np.arange(min(int(r), 9)) for r in resolution], indexing="ij"), -1).reshape(-1, 3)
        side = (hi - lo) / resolution
        found.append((lo + k * side, lo + (k + 1) * side))
    lo, hi = (np.concatenate([np.asarray(pair[k], np.float64) for pair in found]) for k in (0, 1))
    real = np.isfinite(lo).all(axis=1) & np.isfinite(hi).all(axis=1) & (lo <= hi).all(axis=1)
    return lo[real], hi[real]


def disagreements(structure: Structure, reference: Structure, ray: Ray) -> dict[str, int]:
    """On how many rays the two differ in each field, and how many hits there are."""
    a, b, shadow = reference.intersect(ray), structure.intersect(ray), structure.occluded(ray)
    dr.eval(a, b, shadow)
    met = np.isfinite(a.t.numpy())
    found = {"hits": int(met.sum())}
    for name in FIELDS[:4]:
        found[name] = int((_values(a, name) != _values(b, name)).sum())
    found["uv"] = int((a.uv.numpy() != b.uv.numpy()).any(axis=0).sum())
    found["occluded"] = int((shadow.numpy() != met).sum())
    return found


def _values(hit: Any, name: str) -> np.ndarray:
    return np.asarray(getattr(hit, name).numpy())
