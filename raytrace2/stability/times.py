"""What extremes cost in time: each case beside a benign one of its size, in turn."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .extreme_cases import CASES, OTHER_SCENES, Case, Make, benign, random_triangles, rays_for
from .meshes import Closed
from .sweep import FEW, Counts, Record
from .tracers import Loaded, Tracer

#: Runs of which the best counts.
_REPEAT = 3

#: Rays of the first run, which tells how many a case may have.
_PROBE = 32


def extremes(tracers: Sequence[Tracer], dtype: str, counts: Counts) -> dict[str, Record]:
    """For each case the time of a ray over that of a benign one; "value" is the worst of these, "cases" has all;
    "builds" has the same of build times."""
    rays = max(min(counts.other, 100_000), FEW)
    usual = rays_for(counts.levels, dtype, rays, counts.seed)
    levels = counts.levels
    while 20 * 4**levels < counts.identical:
        levels += 1
    many = usual if levels == counts.levels else rays_for(levels, dtype, rays, counts.seed)
    records: dict[str, Record] = {}
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
            base = _seconds_a_ray(scene, normal, counts.longest)
            rate = rate or 1 / base
            for name in chosen:
                scene, case, seconds = _load(tracer, CASES[name], closed, o, d, counts.seed)
                label = name if "identical" not in name else f"{len(closed.faces):,} {name}"
                cases[label] = _seconds_a_ray(scene, case, counts.longest) / base
                builds[label] = seconds / build_seconds
        records[tracer.name] = {
            "value": max(cases.values()), "cases": cases, "builds": builds, "rays": rays, "rate": rate,
        }  # fmt: skip
    return records


def _load(
    tracer: Tracer, make: Make, closed: Closed, o: np.ndarray, d: np.ndarray, seed: int
) -> tuple[Loaded, Case, float]:
    case = make(closed, o, d, np.random.default_rng(seed))
    with np.errstate(over="ignore", invalid="ignore"):
        scene = tracer.load(case.surfaces)
    return scene, case, scene.build_seconds


def _seconds_a_ray(scene: Loaded, case: Case, longest: float) -> float:
    """Of the best run of a few, with as many of the rays as ``longest`` seconds allow."""
    scene.closest(case.o[:_PROBE], case.d[:_PROBE])
    probe = scene.closest(case.o[:_PROBE], case.d[:_PROBE]).seconds
    best, count = probe / _PROBE, _PROBE
    while count < len(case.o) and best * count < longest / 8:
        count = min(len(case.o), count * 8)
        best = scene.closest(case.o[:count], case.d[:count]).seconds / count
    for _ in range(_REPEAT - 1):
        best = min(best, scene.closest(case.o[:count], case.d[:count]).seconds / count)
    return best
