"""What each safety costs, and what goes wrong without it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..accel.build import parse_kind
from ..surfaces.primitives import Intersection
from .accuracy import worst_on_planes
from .leaks import leaks
from .meshes import Closed, icosphere, spiky
from .rays import batches, from_inside
from .sweep import FEW, Counts, Record
from .tracers import Loaded, Ours


@dataclass(frozen=True)
class Way:
    """A choice of precision, of the test of triangles, and of whether boxes are widened for rounding."""

    precision: str
    intersection: Intersection
    padded: bool

    @property
    def name(self) -> str:
        """As tables and records call it."""
        return f"{self.precision}, {self.intersection}, {'padded' if self.padded else 'bare'}"


#: Runs of which the best counts.
_REPEAT = 7

#: What is aimed at: key, mesh, target and side; the last is a million radii from the origin.
_AIMS = (
    ("vertex", "ico", "vertex", "outside"),
    ("edge", "spiky", "edge", "inside"),
    ("far", "far", "edge", "inside"),
)


def ways(kind: str) -> list[Way]:
    """The ways in which a structure can be made, the safest first. Boxes without margins are a bvh's alone."""
    name, options = parse_kind(kind)
    choice = (True, False) if name == "bvh" and options.get("volume", "box") == "box" else (True,)
    tests: tuple[Intersection, ...] = ("watertight", "fast")
    return [Way(p, i, padded) for p in ("float32", "float64") for i in tests for padded in choice]


def measure(kind: str, counts: Counts) -> dict[str, Record]:
    """For every way that ``kind`` can be made in, by name: "rate", rays per second on the same random rays, in turn;
    "vertex", "edge" and "far", leaks among "rays" rays at vertices (icosphere from outside), at edges (spiky mesh from
    inside) and at edges a million radii from the origin (icosphere from inside); "t", the worst relative error of t of
    random rays."""
    tracers = {way: _tracer(kind, way) for way in ways(kind)}
    scenes = {way: tracer.load([icosphere(counts.levels, way.precision).mesh]) for way, tracer in tracers.items()}
    rates = _rates(scenes, counts)
    found: dict[str, Record] = {}
    for way, tracer in tracers.items():
        total = max(FEW, min(counts.aimed, counts.random, int(counts.longest / 2 * rates[way])))
        ico = icosphere(counts.levels, way.precision)
        meshes = {"ico": ico, "spiky": spiky(counts.levels, way.precision), "far": ico.placed(1, 1e6)}
        loaded = {key: scenes[way] if key == "ico" else tracer.load([m.mesh]) for key, m in meshes.items()}
        record: Record = {"rate": rates[way], "rays": total}
        for key, mesh, target, side in _AIMS:
            record[key] = _leaks(loaded[mesh], meshes[mesh], target, side, total, counts.seed)
        aimed = from_inside(ico, "random", min(total, counts.other), np.random.default_rng(counts.seed))
        record["t"] = worst_on_planes(ico, aimed, scenes[way].closest(aimed.o, aimed.d))
        found[way.name] = record
    return found


def _tracer(kind: str, way: Way) -> Ours:
    # A structure that has no choice is left as it is.
    choice = len(ways(kind)) > 4
    return Ours(kind, way.precision, way.intersection, way.padded if choice else None)


def _leaks(scene: Loaded, closed: Closed, target: str, side: str, total: int, seed: int) -> int:
    return sum(leaks(closed, b, scene.closest(b.o, b.d)) for b in batches(closed, target, side, total, seed))


def _rates(scenes: dict[Way, Loaded], counts: Counts) -> dict[Way, float]:
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
    return {way: count / seconds for way, seconds in best.items()}
