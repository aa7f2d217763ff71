"""Does the hierarchy give what brute force gives, to the bit? Counts the rays on which they differ, for every kind of
primitive, in both precisions, at scales from 1e-6 to 1e6 and far from the origin, and prints a table.

    python experiments/agreement.py [--rays 1000000] [-o out/agreement.md]
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import raytrace2  # noqa: F401  settles libLLVM before anything imports drjit

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "accel"))

import agreement_cases
import numpy as np

from raytrace2.files import write_atomically

FIELDS = ("hits", "t", "prim", "surface", "instance", "uv", "occluded", "shadow")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--rays", type=int, default=1_000_000, help="rays for each row of the table")
    parser.add_argument("-o", "--output", type=Path, help="write totals by precision as a Markdown table")
    options = parser.parse_args()
    count = options.rays
    totals: dict[str, list[int]] = {}
    print("'shadow' counts rays whose occlusion is not what brute force's closest hit says.")
    print(f"{'scene':34s}{'precision':>10s}" + "".join(f"{f:>10s}" for f in FIELDS) + f"{'seconds':>10s}")
    wrong = 0

    def row(name: str, items: list, points: np.ndarray, precision: str) -> None:
        nonlocal wrong
        begin = time.perf_counter()
        ray = agreement_cases.rays(np.random.default_rng(1), points, count, precision)
        found = agreement_cases.disagreements(items, ray, precision)
        differing = sum(found[f] for f in FIELDS[1:])
        wrong += differing
        sums = totals.setdefault(precision, [0, 0, 0, 0])
        totals[precision] = [a + b for a, b in zip(sums, (1, count, found["hits"], differing), strict=True)]
        seconds = f"{time.perf_counter() - begin:10.1f}"
        print(f"{name:34s}{precision:>10s}" + "".join(f"{found[f]:10d}" for f in FIELDS) + seconds, flush=True)

    rng = np.random.default_rng(0)
    flat = agreement_cases.leaves(np.random.default_rng(0))
    for precision in ("float32", "float64"):
        for name, case in agreement_cases.cases(rng).items():
            row(name, case.items(precision), case.points, precision)
        for scale, shift in ((1e-6, 0.0), (1e6, 0.0), (1.0, 1e4)):
            for name, items in flat.items():
                placed = [agreement_cases.moved(item, scale, shift) for item in items]
                label = f"{name} x {scale:g}" + (f" + {shift:g}" if shift else "")
                row(label, placed, agreement_cases.points_of(placed), precision)
    if options.output:
        lines = ["| precision | scenes | rays | hits | differences |", "|---|---:|---:|---:|---:|"]
        lines += [f"| {p} | " + " | ".join(f"{n:,}" for n in sums) + " |" for p, sums in totals.items()]
        options.output.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(options.output, ("\n".join(lines) + "\n").encode())
    print("every ray agrees" if wrong == 0 else f"{wrong} disagreements")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
