"""How numerically stable is every structure, in both precisions, beside Mitsuba and Embree? The whole scoreboard at
full counts: leaks at vertices and edges, at translations and scales, spawned rays, gaps, errors of t and normals,
the times of extreme cases, and what each safety costs.

    python experiments/stability.py [--scale 1] [--only WORD ...] [--structures KIND ...] [--out out]

Writes stability.md and stability.png; takes the row of broken files from what experiments/hostile_input.py
left in the same folder. Interrupted, it goes on where it was, row by row; structures that are added later are measured
alone; measurements of other code or settings are made anew. The bvh in float32 and Embree get every ray at vertices and
edges, the others as many as --longest allows. ``raytrace2 stability`` does the same with small counts.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import raytrace2 as rt
from raytrace2.stability.report import measure_and_write
from raytrace2.stability.sweep import FULL


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--scale", type=float, default=1.0, help="the share of the full counts (default 1)")
    parser.add_argument("--longest", type=float, default=FULL.longest, help="seconds that a structure may take for a "
                        f"figure before it gets fewer rays (default {FULL.longest:g})")  # fmt: skip
    parser.add_argument("--only", nargs="*", default=[], help="figures whose key contains any of these words")
    parser.add_argument("--structures", nargs="*", default=list(rt.accel.names()))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("out"))
    options = parser.parse_args()
    sizes = {
        key: max(1000, round(getattr(FULL, key) * options.scale)) for key in ("aimed", "random", "other", "identical")
    }
    counts = replace(FULL, **sizes, longest=options.longest, seed=options.seed)
    print(measure_and_write(options.structures, counts, options.out, options.only))
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit("interrupted: the same command goes on from here")
