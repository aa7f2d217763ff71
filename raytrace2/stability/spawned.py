"""Rays that go on from where others hit: do they meet what they leave, or step over what comes next?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .meshes import Closed, icosphere
from .rays import Aimed, batches
from .sweep import FEW, Counts, Record, digest_of, load, share
from .tracers import Loaded, Tracer

#: The largest and the smallest gap between two surfaces that are tried: 10^-1 and 10^-7 radii.
GAPS = (-1, -7)


def tiny(tracers: Sequence[Tracer], dtype: str, counts: Counts) -> dict[str, Record]:
    """From the icosphere of radius 1e-5."""
    return _onward(tracers, icosphere(counts.levels, dtype).placed(1e-5), counts)


def far(tracers: Sequence[Tracer], dtype: str, counts: Counts) -> dict[str, Record]:
    """From the icosphere a million of its radii from the origin."""
    return _onward(tracers, icosphere(counts.levels, dtype).placed(1, 1e6), counts)


def _onward(tracers: Sequence[Tracer], closed: Closed, counts: Counts) -> dict[str, Record]:
    """Rays from outside, at vertices' surroundings; from where they hit, one goes on inwards, which has to meet the
    mesh again ("value" counts those that do not), and one outwards, which must not meet the face that it leaves
    ("self_hits")."""
    aimed = _from_around(closed, counts.other, counts.seed)
    records: dict[str, Record] = {}
    for name, scene in load(tracers, [closed.mesh]).items():
        aimed_here = aimed.first(_share(scene, aimed, 4, counts.longest))
        o, d = aimed_here.o, aimed_here.d
        first, inward = scene.spawned(o, d, lambda n: _cosine(-n, counts.seed))
        again, outward = scene.spawned(o, d, lambda n: _cosine(n, counts.seed + 1))
        hit = np.isfinite(first.t)
        own = np.isfinite(outward.t) & (outward.prim == again.prim) & hit
        _, few_in = scene.spawned(o[:FEW], d[:FEW], lambda n: _cosine(-n, counts.seed))
        records[name] = {
            "value": int((hit & ~np.isfinite(inward.t)).sum()), "self_hits": int(own.sum()), "rays": int(hit.sum()),
            "rate": len(o) / inward.seconds, "few": digest_of(few_in), "all": digest_of(first, inward, outward),
        }  # fmt: skip
    return records


def gaps(tracers: Sequence[Tracer], dtype: str, counts: Counts) -> dict[str, Record]:
    """Two icospheres of radius 1e-3, one about the other: the smallest gap, in radii, at which, as at every larger one,
    each ray from the inner one outwards meets the outer."""
    sizes = 10.0 ** np.linspace(*GAPS, 1 + 6 * counts.gaps_a_decade)
    inner = icosphere(counts.levels, dtype).placed(1e-3)
    aimed = from_center(inner, min(counts.other, 20_000), counts.seed)
    records: dict[str, Record] = {}
    for tracer in tracers:
        smallest, rate, digests = np.inf, 0.0, []
        count = len(aimed)
        for gap in sizes.tolist():
            outer = inner.placed(1 + gap)
            scene = load([tracer], [inner.mesh, outer.mesh])[tracer.name]
            if np.isinf(smallest):
                count = _share(scene, aimed, len(sizes), counts.longest)
            o, d = aimed.o[:count], aimed.d[:count]
            # The ray comes from the centre: what its normal is turned towards is inside.
            first, second = scene.spawned(o, d, lambda n: _cosine(-n, counts.seed))
            rate = rate or count / second.seconds
            digests.append(digest_of(second))
            # Outside of the inner mesh, which is convex, there is nothing but the outer one.
            if not (np.isfinite(first.t) & np.isfinite(second.t)).all():
                break
            smallest = gap
        same = "".join(digests)
        records[tracer.name] = {
            "value": smallest, "rays": count, "rate": rate, "few": digests[0] if count == len(aimed) else "",
            "all": same,
        }  # fmt: skip
    return records


def from_center(closed: Closed, count: int, seed: int) -> Aimed:
    """Rays from the centre, anywhere."""
    d = np.random.default_rng(seed).normal(size=(count, 3))
    d = (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(closed.dtype)
    return Aimed(np.repeat(np.array([closed.center]), count, axis=0), d, np.full(count, np.inf))


def _from_around(closed: Closed, count: int, seed: int) -> Aimed:
    parts = list(batches(closed, "edge", "outside", count, seed))
    o, d, reach = (np.concatenate([getattr(p, key) for p in parts]) for key in ("o", "d", "reach"))
    # Off the edge, so that faces are met in their middle as well.
    rng = np.random.default_rng(seed)
    d = d + 0.05 * rng.normal(size=d.shape)
    return Aimed(o, (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(closed.dtype), reach)


def _share(scene: Loaded, aimed: Aimed, passes: int, longest: float) -> int:
    return min(len(aimed), max(int(len(aimed) * share(scene, aimed, passes * len(aimed), longest)), FEW))


def _cosine(n: np.ndarray, seed: int) -> np.ndarray:
    """Directions about ``n``, as often as their cosine is large; never in the surface."""
    sphere = np.random.default_rng(seed).normal(size=n.shape)
    d = n + 0.99 * sphere / np.linalg.norm(sphere, axis=1, keepdims=True)
    length = np.linalg.norm(d, axis=1, keepdims=True)
    return d / np.where(length > 0, length, 1)
