"""Does every structure, and every combination of them, give what brute force gives, to the bit? Counts the rays on
which they differ, for all combinations of tests/accel/combinations.py on scenes by formula: rays through shared edges,
along axes, in the planes of splits and cell walls, from on surfaces and cells, from far away, and random ones.

    python experiments/combinations.py [--rays 1000000] [--combinations WORD ...] [--scenes WORD ...]
                                       [--precision float32] [--out out/combinations]

Writes combinations.md. Interrupted, it goes on where it was; results of other code or settings are made anew.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import raytrace2 as rt

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "accel"))

import agreement_cases
import combinations as listed  # those of the tests, whose folder comes first
import numpy as np
from structure_speed import tracing_digest
from study import markdown_table, read_json, save_json, save_text
from tqdm import tqdm

from raytrace2.surfaces.surface import Surface

#: Scenes of the field, with few primitives: brute force tests each of them against every ray.
PROCEDURAL = ("architecture", "balls", "gears", "lattice", "slivers", "teapot", "terrain", "tetra")
SIZE = 120

#: At most so many rays at once, which bounds memory.
CHUNK = 1 << 18

FIELDS = listed.FIELDS


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--rays", type=float, default=1e6, help="for each combination, over all scenes (default 1e6)")
    parser.add_argument("--combinations", nargs="*", default=[], help="those whose name contains any of these words")
    parser.add_argument("--scenes", nargs="*", default=[], help="those whose name contains any of these words")
    parser.add_argument("--precision", choices=("float32", "float64"), default="float32")
    parser.add_argument("--out", type=Path, default=Path("out/combinations"))
    options = parser.parse_args()
    every = listed.combinations()
    names = _chosen(every, options.combinations)
    made = scenes()
    used = _chosen(made, options.scenes)
    per_scene = -(-int(options.rays) // len(used))
    sources = b"".join(Path(str(m.__file__)).read_bytes() for m in (listed, agreement_cases))
    settings = {"code": tracing_digest(), "list": hashlib.sha256(sources).hexdigest()[:16], "rays": per_scene}
    rows = []
    for name in tqdm(names, unit="combination", disable=None):
        found = []
        for scene in used:
            file = options.out / "records" / options.precision / slug(name) / f"{slug(scene)}.json"
            record = read_json(file)
            if record is None or record["settings"] != settings:
                record = {"settings": settings}
                record |= compared(every[name], made[scene], options.precision, per_scene)
                if "failure" not in record:
                    save_json(file, record)
            found.append(record)
            if "failure" in record or differing(record):
                said = record.get("failure") or {f: record[f] for f in FIELDS if record[f]}
                tqdm.write(f"{name}, {scene}: {said}")
        rows.append(row(name, found))
        tqdm.write(line(rows[-1]))
        write(options.out, rows, used, options.precision)
    wrong = sum(r["differing"] + r["failures"] for r in rows)
    agree = "every ray agrees" if wrong == 0 else f"{wrong} disagreements and failures"
    print(f"{len(rows)} combinations, {len(used)} scenes: {agree}; written: {options.out / 'combinations.md'}")
    return int(wrong > 0)


def scenes() -> dict[str, Sequence[Surface]]:
    """Every scene by name: kinds of primitive alone and together, and scenes of the field."""
    found: dict[str, Sequence[Surface]] = dict(agreement_cases.leaves(np.random.default_rng(0)))
    return found | {name: list(rt.scenes.make(name, SIZE)) for name in PROCEDURAL}


def compared(combination: listed.Combination, items: Sequence[Surface], precision: str, count: int) -> dict[str, Any]:
    """On how many of ``count`` rays a combination differs from brute force, by field; ``failure`` if there is none."""
    begin = time.perf_counter()
    totals = dict.fromkeys(("rays", "hits", *FIELDS), 0)
    try:
        structure = combination.structure(items, precision)
        reference = combination.reference(structure, items)
        points = agreement_cases.points_of(list(items))
        chunks = -(-count // CHUNK)
        for seed in range(chunks):
            ray = listed.hard_rays(combination, structure, points, -(-count // chunks) + 16, seed)
            totals["rays"] += len(ray)
            for key, value in listed.disagreements(structure, reference, ray).items():
                totals[key] += value
    except (rt.RayTraceError, RuntimeError, ValueError, TypeError, IndexError, MemoryError) as error:
        return {"failure": f"{type(error).__name__}: {(str(error).splitlines() or [''])[0]}"}
    return totals | {"seconds": time.perf_counter() - begin}


def differing(record: dict[str, Any]) -> int:
    return sum(record[f] for f in FIELDS)


def row(name: str, records: list[dict[str, Any]]) -> dict[str, Any]:
    """One combination's sums over the scenes."""
    good = [r for r in records if "failure" not in r]
    found = {key: sum(r[key] for r in good) for key in ("rays", "hits", *FIELDS, "seconds")}
    differences = sum(differing(r) for r in good)
    return {"name": name, "scenes": len(good), "failures": len(records) - len(good), "differing": differences, **found}


def line(r: dict[str, Any]) -> str:
    said = "zero" if r["differing"] == 0 else f"{r['differing']} DISAGREEMENTS"
    said += f", {r['failures']} FAILURES" if r["failures"] else ""
    return f"{r['name']:48s}{r['rays']:>12,} rays {r['hits']:>12,} hits {r['seconds']:7.1f} s  {said}"


def write(out: Path, rows: list[dict[str, Any]], used: Sequence[str], precision: str) -> None:
    """The table of what is there so far."""
    head = ["combination", "scenes", "rays", "hits", *FIELDS, "failures"]
    cells = [[r["name"], *(f"{r[k]:,}" for k in ("scenes", "rays", "hits", *FIELDS, "failures"))] for r in rows]
    total = {k: sum(r[k] for r in rows) for k in ("rays", "hits", "differing", "failures")}
    text = (
        f"# Combinations of structures against brute force, {precision}\n\n## Totals\n\n"
        f"| combinations | scenes | rays | hits | differences | failures |\n|---:|---:|---:|---:|---:|---:|\n"
        f"| {len(rows)} | {len(used)} | {total['rays']:,} | {total['hits']:,} | {total['differing']:,} "
        f"| {total['failures']:,} |\n\n## Each\n\nScenes: {', '.join(used)}. 'occluded' counts rays whose occlusion is "
        f"not what brute force's closest hit says.\n\n{markdown_table(head, cells)}"
    )
    save_text(out / "combinations.md", text)


def _chosen(among: dict[str, Any], words: Sequence[str]) -> list[str]:
    found = [name for name in among if not words or any(word in name for word in words)]
    if not found:
        raise SystemExit(f"no name contains {' or '.join(words)}; there are {', '.join(among)}")
    return found


def slug(name: str) -> str:
    """A name that a file can have, different for every combination."""
    return "".join(c if c.isalnum() or c in "_=." else "-" for c in name)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit("interrupted: the same command goes on from here")
