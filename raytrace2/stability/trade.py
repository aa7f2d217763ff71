"""What each safety costs, and what goes wrong without it."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import numpy as np

from .leaks import leaks
from .meshes import Closed, icosphere, spiky
from .rays import batches, from_inside
from .sweep import FEW, Counts, Record
from .tracers import Loaded, Ours

#: The ways that are timed in turn: precision and intersection.
WAYS = tuple((p, i) for p in ("float32", "float64") for i in ("watertight", "fast"))

_REPEAT = 7


def measure(kinds: Sequence[str], counts: Counts) -> dict[str, Record]:
    """For every kind and way: rays per second on the same random rays, in turn, and leaks among rays at vertices
    (icosphere from outside), at edges (spiky mesh from inside). Keys read
    "kind precision intersection"."""
    found: dict[str, Record] = {}
    for kind in kinds:
        tracers = {(p, i): Ours(kind, p, i) for p, i in WAYS}
        scenes = {way: t.load([icosphere(counts.levels, way[0]).mesh]) for way, t in tracers.items()}
        rates = _rates(scenes, counts)
        for way, tracer in tracers.items():
            record: Record = {"rate": rates[way]}
            total = max(FEW, min(counts.aimed, int(counts.longest * rates[way])))
            closed = icosphere(counts.levels, way[0])
            record["vertex"] = _leaks(scenes[way], closed, "vertex", "outside", total, counts.seed)
            thorny = spiky(counts.levels, way[0])
            record["edge"] = _leaks(tracer.load([thorny.mesh]), thorny, "edge", "inside", total, counts.seed)
            found[" ".join((kind, *way))] = record | {"rays": total}
    return found


def _leaks(scene: Loaded, closed: Closed, target: str, side: str, total: int, seed: int) -> int:
    return sum(leaks(closed, b, scene.closest(b.o, b.d)) for b in batches(closed, target, side, total, seed))


def _rates(scenes: dict[tuple[str, str], Loaded], counts: Counts) -> dict[tuple[str, str], float]:
    """Rays per second of each, the best of runs in turn."""
    aimed = from_inside(icosphere(counts.levels, "float32"), "random", 200_000, np.random.default_rng(counts.seed))
    probe = {}
    for way, scene in scenes.items():
        scene.closest(aimed.o[:FEW], aimed.d[:FEW])
        probe[way] = scene.closest(aimed.o[:FEW], aimed.d[:FEW]).seconds / FEW
    count = int(min(len(aimed), max(FEW, counts.longest / max(probe.values()))))
    best = dict.fromkeys(scenes, np.inf)
    for turn in range(_REPEAT):
        for way, scene in scenes.items():
            seconds = scene.closest(aimed.o[:count], aimed.d[:count]).seconds
            best[way] = min(best[way], seconds) if turn else best[way]
    dr.sync_thread()
    return {way: count / seconds for way, seconds in best.items()}
