"""The same scene and rays at any power of two: who misses where, and whose t changes its bits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .meshes import icosphere
from .rays import from_inside
from .sweep import FEW, Counts, Record, digest_of, load, share
from .tracers import Answer, Tracer

LARGEST = 60


def sweep(tracers: Sequence[Tracer], dtype: str, counts: Counts) -> dict[str, Record]:
    """Random rays in the icosphere times 2^k for k from -60 to 60. "value" counts rays whose t / 2^k or primitive is
    not that at k = 0; "low" and "high" are the exponents between which none misses; "missed" those where any does."""
    base = icosphere(counts.levels, dtype)
    rays = from_inside(base, "random", counts.other, np.random.default_rng(counts.seed))
    exponents = [0, *(s * k for k in range(counts.scale_step, LARGEST + 1, counts.scale_step) for s in (1, -1))]
    exponents += [s * LARGEST for s in (1, -1) if s * LARGEST not in exponents]
    records: dict[str, Record] = {}
    for tracer in tracers:
        missed: list[int] = []
        changed, seconds, count = 0, 0.0, len(rays)
        wanted: Answer | None = None
        few = ""
        for exponent in exponents:
            factor = 2.0**exponent
            scene = load([tracer], [base.placed(factor).mesh])[tracer.name]
            if wanted is None:
                few = digest_of(scene.closest(rays.o[:FEW], rays.d[:FEW]))
                part = share(scene, rays, len(exponents) * len(rays), counts.longest)
                count = min(len(rays), max(int(part * len(rays)), FEW))
            answer = scene.closest(rays.o[:count] * factor, rays.d[:count])
            wanted = wanted or answer
            seconds = seconds or answer.seconds
            if not np.isfinite(answer.t).all():
                missed.append(exponent)
            with np.errstate(over="ignore"):
                t = answer.t.astype(np.float64) / factor
            hit = np.isfinite(wanted.t)
            changed += int(((t != wanted.t) | (hit & (answer.prim != wanted.prim))).sum())
        records[tracer.name] = {
            "value": changed, "rays": count * len(exponents), "rate": count / seconds, "few": few, "missed": missed,
            "low": min([e for e in exponents if not any(e <= m <= 0 for m in missed)], default=None),
            "high": max([e for e in exponents if not any(0 <= m <= e for m in missed)], default=None),
            "all": digest_of(wanted) if wanted else "",
        }  # fmt: skip
    return records
