"""Which acceleration structure wins on which scene, and why? Every structure on every scene of the field: build
seconds, bytes, rays per second for primary, bounce and shadow rays beside the default hierarchy (in turn with it) and,
where a scene has triangles alone, beside Mitsuba on the same rays; what rays meet on the way.

    python experiments/structures.py [--size 10000] [--scenes WORD ...] [--structures WORD ...] [--out out/structures]

Writes structures.md (winners, then a table for each scene) and structures.png. Interrupted, it goes on where it was;
measurements of other code or settings are made anew.
"""

from __future__ import annotations

import argparse
import platform
import sys
from pathlib import Path
from typing import Any

from charts import heat_chart
from structure_speed import NORMAL, RAY_KINDS, Bench, structures, timed_build, tracing_digest
from structure_winners import Record, build_winner, ranked, reasons, relative, scene_table, short, winner_table
from study import read_json, save_image, save_json, save_text
from tqdm import tqdm

import raytrace2 as rt
from raytrace2.reference.mitsuba_scene import mitsuba_variant


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--size", type=float, default=1e4, help="primitives of a scene, about (default 10000)")
    parser.add_argument("--side", type=int, default=512, help="primary rays along a side of the image (default 512)")
    parser.add_argument("--repeat", type=int, default=15, help="runs of which the best counts (default 15)")
    parser.add_argument("--longest", type=float, default=3.0, help="seconds after which runs are not repeated, and "
                        "which a structure may take before it gets fewer rays (default 3)")  # fmt: skip
    parser.add_argument("--scenes", nargs="*", default=[], help="scenes whose name contains any of these words")
    parser.add_argument("--structures", nargs="*", default=[], help="structures whose name contains any of these words")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("out/structures"))
    options = parser.parse_args()
    names = [n for n in rt.scenes.names() if not options.scenes or any(word in n for word in options.scenes)]
    if not names:
        raise SystemExit(f"no such scene; there are {', '.join(rt.scenes.names())}")
    chosen = structures(options.structures)
    settings = {"code": tracing_digest(), "machine": platform.node()}
    settings |= {key: getattr(options, key) for key in ("size", "side", "repeat", "longest", "seed")}
    found: dict[str, list[Record]] = {}
    failures: list[str] = []
    with mitsuba_variant("llvm_ad_rgb") as mi, tqdm(total=len(names) * len(chosen), unit="row", disable=None) as bar:
        for name in names:
            records = []
            for record in measured(mi, name, chosen, settings, options):
                bar.update()
                if "failure" in record:
                    failures.append(f"- {record['scene']}, {record['structure']}: {record['failure']}\n")
                    tqdm.write(failures[-1].strip())
                else:
                    records.append(record)
                    tqdm.write(line(record))
            if records:
                found[name] = records
                write(options.out, found, failures, settings)
    print(f"written: {options.out / 'structures.md'}, {options.out / 'structures.png'}")
    return int(bool(failures))


def measured(mi: Any, name: str, chosen: list[str], settings: dict[str, Any], options: argparse.Namespace) -> Any:
    """The records of one scene, one after the other; those that are there already are only read."""
    bench = None
    for structure in chosen:
        file = options.out / "records" / f"{options.size:g}" / name / f"{structure.replace(':', '.')}.json"
        stored = read_json(file)
        if stored is None or stored["settings"] != settings:
            if bench is None:
                scene = rt.scenes.make(name, options.size, options.seed)
                bench = Bench(mi, scene, options.side, options.repeat, options.longest)
            stored = measure(bench, structure, settings)
            if "failure" not in stored:
                save_json(file, stored)
        yield stored


def measure(bench: Bench, name: str, settings: dict[str, Any]) -> Record:
    """What one structure does on one scene; ``failure`` instead, where it cannot be built or asked."""
    scene = bench.scene
    record: Record = {"scene": scene.name, "structure": name, "kind": name.partition(":")[0], "settings": settings}
    try:
        structure, seconds = timed_build(scene, name, bench.longest)
        said = {k: v for k, v in structure.statistics().items() if isinstance(v, int | float) or hasattr(v, "item")}
        said = {k: v.item() if hasattr(v, "item") else v for k, v in said.items()}
        rays = bench.speeds(structure)
    except (rt.RayTraceError, RuntimeError, ValueError, TypeError, MemoryError) as error:
        return record | {"failure": (str(error).splitlines() or [type(error).__name__])[0]}
    return record | {"primitives": scene.primitive_count, "build_seconds": seconds, "statistics": said, "rays": rays}


def line(record: Record) -> str:
    rates = "  ".join(f"{k} {record['rays'][k]['rate'] / 1e6:7.3f} ({relative(record, k):4.2f})" for k in RAY_KINDS)
    return f"{record['scene']:14s}{record['structure']:36s}{rates}  build {record['build_seconds']:.3f} s"


def write(out: Path, scenes: dict[str, list[Record]], failures: list[str], settings: dict[str, Any]) -> None:
    """The tables and the picture of what is there so far."""
    about = (
        f"About {settings['size']:g} primitives a scene. In brackets, how much faster than the best structure of "
        f"another kind; 'build' is the quickest to build of those at least half as fast as the fastest on bounces. A "
        f"ray's time is its steps (nodes or cells, or volumes in lists, and primitives) by the time of a "
        f"step: 'why' names the factor that tells winner and runner-up apart more.\n"
    )
    text = f"# Structures and scenes\n\n## Winners\n\n{about}\n{winner_table(scenes)}\n"
    text += (
        f"## Scenes\n\nRates are the best of {settings['repeat']} runs; '/ {NORMAL}' is the rate over that of the "
        f"default hierarchy, '/ Embree' over Mitsuba's, on the same rays and in turn. Volumes, nodes and primitives "
        f"are counted means of bounces; 'expected' is what the builder expects of a random line that stops nowhere.\n\n"
    )
    for name, records in scenes.items():
        first = records[0]
        counts = ", ".join(f"{first['rays'][k]['hits']:.0%} of {k} rays hit" for k in RAY_KINDS)
        about = f"{first['primitives']:,} primitives; {counts}."
        text += f"### {name}\n\n{about}\n\n{scene_table(records)}\n{reasons(records)}\n"
    if failures:
        text += f"## Not measured\n\n{''.join(failures)}"
    save_text(out / "structures.md", text)
    save_image(out / "structures.png", picture(scenes, settings))


def picture(scenes: dict[str, list[Record]], settings: dict[str, Any]) -> Any:
    """Rates by colour, in percent of the fastest on the same scene; build times likewise, of the quickest."""
    names = list(dict.fromkeys(r["structure"] for records in scenes.values() for r in records))
    labels = [short({"structure": n}) for n in names]
    panels: dict[str, list[list[float | None]]] = {}
    for kind in RAY_KINDS:
        rows = []
        for records in scenes.values():
            best = relative(ranked(records, kind)[0], kind)
            mine = {r["structure"]: relative(r, kind) / best for r in records}
            rows.append([mine.get(n) for n in names])
        panels[f"{kind} rays"] = rows
    rows = []
    for records in scenes.values():
        quick = build_winner(records)["build_seconds"]
        builds = {r["structure"]: min(1.0, quick / max(r["build_seconds"], 1e-9)) for r in records}
        rows.append([builds.get(n) for n in names])
    panels["builds (of the quickest that is good)"] = rows
    title = f"Rays per second in percent of the fastest on each scene of {settings['size']:g} primitives"
    return heat_chart(title, list(scenes), labels, panels)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit("interrupted: the same command goes on from here")
