"""How do structures scale? Seconds, steps and bytes per ray and per build as scenes grow tenfold from 10^2 to 10^6
primitives, with fitted exponents: linear for brute force, next to nothing for hierarchies.

    python experiments/complexity.py [--largest 1000000] [--scenes bumpy_sphere soup] [--structures WORD ...]
                                     [--out out/complexity]

All sizes of a structure take turns, so that what else the machine does falls on all of them. Writes complexity.md and
complexity.png. Interrupted, it goes on where it was, by scene and structure.
"""

from __future__ import annotations

import argparse
import math
import platform
import sys
from pathlib import Path
from typing import Any

import numpy as np
from charts import log_charts
from structure_speed import FEW, counters, rays_of, thinned, timed_build, tracing_digest
from study import markdown_table, read_json, save_image, save_json, save_text
from tqdm import tqdm

import raytrace2 as rt
from raytrace2.reference.ray_speed import best_times, our_task

KINDS = ("primary", "bounce")

#: What a ray's time and a ray's visits may grow by from the first to the last of these sizes, in a hierarchy.
FROM, TO = 10**3, 10**6
MOST_TIME, MOST_VISITS = 6.0, 2.5

#: Structures whose cost is meant to hardly grow; the others are grids, lists and brute force.
HIERARCHIES = ("bvh", "kdtree", "bsp")

Record = dict[str, Any]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--largest", type=float, default=TO, help="primitives of the largest scene (default 1000000)")
    parser.add_argument(
        "--scenes", nargs="*", default=["bumpy_sphere", "soup"], choices=rt.scenes.names(), metavar="NAME"
    )
    parser.add_argument("--structures", nargs="*", default=list(rt.accel.names()), help="as --accel takes them")
    parser.add_argument("--side", type=int, default=512, help="primary rays along a side of the image (default 512)")
    parser.add_argument("--repeat", type=int, default=15, help="runs of which the best counts (default 15)")
    parser.add_argument("--longest", type=float, default=20.0, help="seconds that the runs of a structure may take, "
                        "and one query of it; larger scenes are left out (default 20)")  # fmt: skip
    parser.add_argument("--out", type=Path, default=Path("out/complexity"))
    options = parser.parse_args()
    settings = {"code": tracing_digest(), "machine": platform.node()}
    settings |= {key: getattr(options, key) for key in ("side", "repeat", "longest", "largest")}
    records: list[Record] = []
    with tqdm(total=len(options.scenes) * len(options.structures), unit="structure", disable=None) as bar:
        for name in options.scenes:
            sizes: dict[int, Sized] = {}
            for structure in options.structures:
                file = options.out / "records" / name / f"{structure.replace(':', '.')}.json"
                record = read_json(file)
                if record is None or record["settings"] != settings:
                    sizes = sizes or {n: Sized(name, n, options.side) for n in _tenfold(options.largest)}
                    record = {"scene": name, "structure": structure, "settings": settings}
                    record["points"] = measured(sizes, structure, options)
                    save_json(file, record)
                records.append(record)
                bar.update()
                tqdm.write(name + ": " + ", ".join(row(record)))
                write(options.out, records)
    print(f"written: {options.out / 'complexity.md'}, {options.out / 'complexity.png'}")
    return 0


class Sized:
    """A scene of one size, with rays: many, and few for what is slow."""

    def __init__(self, name: str, size: int, side: int) -> None:
        self.scene = rt.scenes.make(name, size)
        structure = rt.accel.build(self.scene, "bvh")
        every = rays_of(self.scene, structure, side)
        self.many = {k: every[k] for k in KINDS}
        self.few = thinned(self.many, FEW)


def _tenfold(largest: float) -> list[int]:
    return [10**k for k in range(2, 1 + round(math.log10(largest)))]


def measured(sizes: dict[int, Sized], name: str, options: argparse.Namespace) -> list[dict[str, Any]]:
    """What a structure costs at each size up to where it becomes too slow."""
    built, points, before = {}, [], 0.0
    for n, sized in sizes.items():
        # Ten times the primitives may be ten times the work.
        if 10 * before > options.longest:
            break
        structure, seconds = timed_build(sized.scene, name, 1.0)
        before = best_times({"": our_task(structure, sized.few["bounce"], False)}, 1)[""]
        built[n] = structure
        size = structure.statistics()["bytes"]
        points.append({
            "n": sized.scene.primitive_count, "size": n, "build_seconds": seconds, "bytes": size,
            "counts": {kind: counters(structure, ray) for kind, ray in sized.few.items()}, "seconds": {},
        })  # fmt: skip
    # As many for all sizes: what does not fill the threads would be slower by itself.
    fast = before * options.side**2 / FEW < 0.05 * options.longest
    for kind in KINDS:
        rays = {n: (sizes[n].many if fast else sizes[n].few)[kind] for n in built}
        tasks = {n: our_task(structure, rays[n], False) for n, structure in built.items()}
        best = best_times(tasks, options.repeat, options.longest)
        for point in points:
            point["seconds"][kind] = best[point["size"]] / len(rays[point["size"]])
    return points


def visits(point: dict[str, Any], kind: str) -> float:
    """Nodes or cells that a ray visits; volumes where there are only these, primitives where there is nothing else."""
    counts = point["counts"][kind]
    return counts["nodes"] or counts["volumes"] or counts["primitives"]


def series(record: Record, what: str, kind: str = "") -> list[tuple[float, float]]:
    """A quantity by the number of primitives."""
    if what == "visits":
        return [(p["n"], visits(p, kind)) for p in record["points"]]
    return [(p["n"], p[what][kind] if kind else p[what]) for p in record["points"]]


def exponent(curve: list[tuple[float, float]]) -> float:
    """The power of n that fits best in the logarithm, from a thousand primitives on; NaN from one point."""
    x, y = (np.log([p[k] for p in curve if p[0] >= 0.9 * FROM and p[1] > 0]) for k in (0, 1))
    return float(np.polyfit(x, y, 1)[0]) if len(x) > 1 else math.nan


def growth(record: Record, what: str, kind: str) -> float | None:
    """By how much a quantity grew from :data:`FROM` to :data:`TO` primitives; None if either was not measured."""
    of = {p["size"]: value for p, (_, value) in zip(record["points"], series(record, what, kind), strict=True)}
    return of[TO] / of[FROM] if FROM in of and TO in of and of[FROM] else None


HEAD = ["scene", "structure", *(f"ns per ray at 10^{k}" for k in range(2, 7)),
        *(f"{k} time, 10^6 / 10^3" for k in KINDS), *(f"{k} visits, 10^6 / 10^3" for k in KINDS),
        "exponent: time", "visits", "build", "build at the largest, s", "MB", "below 6x and 2.5x"]  # fmt: skip


def row(record: Record) -> list[str]:
    """One line of the table; times in the columns by size are those of bounces."""
    times = {p["size"]: f"{p['seconds']['bounce'] * 1e9:.3g}" for p in record["points"]}
    grown = {(what, k): growth(record, what, k) for what in ("seconds", "visits") for k in KINDS}
    powers = [exponent(series(record, *q)) for q in (("seconds", "bounce"), ("visits", "bounce"), ("build_seconds",))]
    last = record["points"][-1]
    verdict = ""
    if record["structure"].partition(":")[0] in HIERARCHIES and None not in grown.values():
        bad = [
            f"{k} {'time' if what == 'seconds' else what}" for (what, k), g in grown.items()
            if g is not None and g >= (MOST_TIME if what == "seconds" else MOST_VISITS)
        ]  # fmt: skip
        verdict = "yes" if not bad else "not " + ", ".join(bad)
    return [
        record["scene"], record["structure"], *(times.get(10**k, "") for k in range(2, 7)),
        *("" if g is None else f"{g:.2f}" for g in grown.values()), *(f"{p:.2f}" for p in powers),
        f"{last['build_seconds']:.2f}", f"{last['bytes'] / 1e6:.1f}", verdict,
    ]  # fmt: skip


def write(out: Path, records: list[Record]) -> None:
    """The table and the picture of what is there so far."""
    about = (
        "Times are of the best run, all sizes in turn. Exponents are of the power of the number of primitives that "
        "fits best from 10^3 on: 1 is linear, 0 does not grow. Visits are nodes or cells (volumes in lists, primitives "
        "in brute force). Sizes at which a query would have taken too long are left out.\n"
    )
    save_text(out / "complexity.md", f"# Cost by size\n\n{about}\n{markdown_table(HEAD, [row(r) for r in records])}")
    panels: dict[str, dict[str, list[tuple[float, float]]]] = {}
    for scene in dict.fromkeys(r["scene"] for r in records):
        mine = {r["structure"]: r for r in records if r["scene"] == scene}
        panels[f"{scene}: ns per bounce"] = {
            s: [(n, t * 1e9) for n, t in series(r, "seconds", "bounce")] for s, r in mine.items()
        }
        panels[f"{scene}: visits per bounce"] = {s: series(r, "visits", "bounce") for s, r in mine.items()}
        panels[f"{scene}: ms per build"] = {
            s: [(n, t * 1e3) for n, t in series(r, "build_seconds")] for s, r in mine.items()
        }
    save_image(out / "complexity.png", log_charts("Cost by size", panels, "primitives"))


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit("interrupted: the same command goes on from here")
