"""What extremes cost in time: each case beside a benign one of its size, in turn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..surfaces.mesh import TriangleMesh
from .extreme_cases import CASES, OTHER_SCENES, Case, Make, benign, random_triangles, rays_for
from .meshes import Closed
from .sweep import FEW, Counts, Record
from .tracers import Loaded, Tracer

#: Runs of which the best counts.
_REPEAT = 5

#: A build that takes fewer seconds is made twice.
_QUICK = 0.5

#: Rays of which it is asked how many boxes they meet.
_LOOKED_AT = 64

#: Seconds that a run need not go beyond.
_LONGEST = 0.1

#: Rays of the first run, which tells how many a case may have.
_PROBE = 32


def extremes(tracers: Sequence[Tracer], dtype: str, counts: Counts) -> dict[str, Record]:
    """For each case the time of a ray over that of a benign one; "value" is the worst of these, "cases" has all;
    "builds" has the same of build times, "met" of the triangles whose boxes rays meet on their way: what any structure
    of boxes has to look at."""
    rays = max(min(counts.other, 100_000), FEW)
    usual = rays_for(counts.levels, dtype, rays, counts.seed)
    levels = counts.levels
    while 20 * 4**levels < counts.identical:
        levels += 1
    many = usual if levels == counts.levels else rays_for(levels, dtype, rays, counts.seed)
    records: dict[str, Record] = {}
    met: dict[str, float] = {}
    for tracer in tracers:
        cases: dict[str, float] = {}
        builds: dict[str, float] = {}
        rate = 0.0
        for (closed, o, d), chosen, measure in (
            (usual, [c for c in CASES if c not in OTHER_SCENES], benign),
            (usual, [c for c in OTHER_SCENES if "identical" not in c], random_triangles),
            (many, ["identical triangles"], random_triangles),
        ):
            scene, normal, build_seconds = _load(tracer, measure, closed, o, d, counts.seed)
            usual_run = _Run.of(scene, normal, counts.longest)
            rate = rate or 1 / usual_run.best
            usually = boxes_met(scene, normal) if tracer is tracers[0] else 0.0
            for name in chosen:
                scene, case, seconds = _load(tracer, CASES[name], closed, o, d, counts.seed)
                label = name if "identical" not in name else f"{len(closed.faces):,} {name}"
                cases[label] = _in_turn(_Run.of(scene, case, counts.longest), usual_run)
                builds[label] = seconds / build_seconds
                if tracer is tracers[0]:
                    met[label] = boxes_met(scene, case) / usually
        records[tracer.name] = {
            "value": max(cases.values()), "cases": cases, "builds": builds, "met": met, "rays": rays, "rate": rate,
        }  # fmt: skip
    return records


def boxes_met(scene: Loaded, case: Case) -> float:
    """How many triangles' boxes a ray meets no later than what it hits, in the mean of the first few. What is no ray
    meets none."""
    o, d = case.o[:_LOOKED_AT], case.d[:_LOOKED_AT]
    t = scene.closest(o, d).t.astype(np.float64)
    corners = np.concatenate([s.vertices[s.faces] for s in case.surfaces if isinstance(s, TriangleMesh)])
    lo, hi = corners.min(axis=1), corners.max(axis=1)
    met = 0
    for origin, direction, end in zip(o.astype(np.float64), d.astype(np.float64), t, strict=True):
        if not (np.isfinite(origin).all() and np.isfinite(direction).all()):
            continue
        begin = np.zeros(len(lo))
        leave = np.full(len(lo), end)
        for k in np.flatnonzero(direction):
            with np.errstate(all="ignore"):
                near, far = ((plane[:, k] - origin[k]) / direction[k] for plane in (lo, hi))
            begin, leave = np.maximum(begin, np.minimum(near, far)), np.minimum(leave, np.maximum(near, far))
        beside = ((direction == 0) & ((origin < lo) | (origin > hi))).any(axis=1)
        met += int(((begin <= leave) & ~beside).sum())
    return met / len(t)


def _load(
    tracer: Tracer, make: Make, closed: Closed, o: np.ndarray, d: np.ndarray, seed: int
) -> tuple[Loaded, Case, float]:
    case = make(closed, o, d, np.random.default_rng(seed))
    with np.errstate(over="ignore", invalid="ignore"):
        scene = tracer.load(case.surfaces)
        seconds = scene.build_seconds
        if seconds < _QUICK:
            # The first of its kind may have fetched kernels.
            seconds = min(seconds, tracer.load(case.surfaces).build_seconds)
    return scene, case, seconds


@dataclass
class _Run:
    """The first ``count`` rays of a case, as many as may take the time, and the ``best`` seconds a ray so far."""

    scene: Loaded
    case: Case
    count: int
    best: float

    @staticmethod
    def of(scene: Loaded, case: Case, longest: float) -> _Run:
        scene.closest(case.o[:_PROBE], case.d[:_PROBE])
        run = _Run(scene, case, _PROBE, math.inf)
        run.again()
        while run.count < len(case.o) and run.best * run.count < min(longest / 8, _LONGEST):
            run = _Run(scene, case, min(len(case.o), run.count * 8), math.inf)
            run.again()
        return run

    def again(self) -> None:
        seconds = self.scene.closest(self.case.o[: self.count], self.case.d[: self.count]).seconds
        self.best = min(self.best, seconds / self.count)


def _in_turn(run: _Run, usual: _Run) -> float:
    """How many times as long a ray takes as usual: the best of some runs each, in turn, so that both meet the machine
    in the same state."""
    run.best = usual.best = math.inf
    for _ in range(_REPEAT):
        usual.again()
        run.again()
    return run.best / usual.best
