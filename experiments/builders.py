"""What do the builders, widths and volumes of a hierarchy trade? Build seconds, nodes, depth, surface-area cost, what a
ray visits and tests, and rays per second, over a smooth body, a soup, a terrain, slivers and a building.

    python experiments/builders.py [--size 100000] [--rays 300000] [--repeat 3] [--scene NAME] [-o TABLE.md]

Rays start at random points of the scene's box in random directions; speeds are of the best of the repeats, in turn.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import get_args

import raytrace2  # noqa: F401  settles libLLVM before anything imports drjit

# isort: split
import drjit as dr
import numpy as np

from raytrace2.accel import Bvh, BvhConfig
from raytrace2.accel.bvh_config import Builder
from raytrace2.files import write_atomically
from raytrace2.rays.ray import Ray
from raytrace2.scene.procedural import make
from raytrace2.surfaces.geometry import Geometry
from raytrace2.types import types

KINDS = {f"builder={b}": BvhConfig(builder=b) for b in get_args(Builder)}
KINDS |= {"width=2": BvhConfig(width=2), "width=8": BvhConfig(width=8)}
KINDS |= {"volume=sphere": BvhConfig(volume="sphere"), "volume=oriented_box": BvhConfig(volume="oriented_box")}
SCENES = ["bumpy_sphere", "soup", "terrain", "slivers", "architecture"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--size", type=float, default=1e5, help="primitives of a scene")
    parser.add_argument("--rays", type=int, default=300_000)
    parser.add_argument("--repeat", type=int, default=3, help="runs of each, of which the best counts")
    parser.add_argument("--scene", action="append", help=f"may be repeated (default: {', '.join(SCENES)})")
    parser.add_argument("-o", "--output", type=Path, help="write the table there too")
    arguments = parser.parse_args()
    lines = [
        "| scene | bvh | build, s | nodes | depth | references | SAH cost | nodes/ray | tests/ray | Mrays/s | vs sah |",
        "|---|---|" + "---:|" * 9,
    ]
    print("\n".join(lines))
    for scene in arguments.scene or SCENES:
        for line in _measure(scene, int(arguments.size), arguments.rays, arguments.repeat):
            print(line, flush=True)
            lines.append(line)
    if arguments.output is not None:
        arguments.output.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(arguments.output, ("\n".join(lines) + "\n").encode())


def _measure(scene: str, size: int, rays: int, repeat: int) -> list[str]:
    geometry = Geometry(list(make(scene, size)), types("float32"))
    made = []
    for config in KINDS.values():
        # The first build may compile kernels.
        Bvh(geometry, config)
        made.append(Bvh(geometry, config))
    lo, hi = made[0].bounds()
    rng = np.random.default_rng(0)
    ray = Ray(rng.uniform(size=(rays, 3)) * (hi - lo) + lo, rng.normal(size=(rays, 3)))
    dr.eval(ray)
    best = np.full(len(KINDS), np.inf)
    for turn in range(repeat + 1):
        for k, structure in enumerate(made):
            begin = time.perf_counter()
            dr.eval(structure.intersect(ray))
            dr.sync_thread()
            if turn:
                best[k] = min(best[k], time.perf_counter() - begin)
    speeds, sah = rays / best / 1e6, list(KINDS).index("builder=sah")
    lines = []
    for kind, structure, speed in zip(KINDS, made, speeds, strict=True):
        found, counts = structure.statistics(), structure.count(ray)[1]
        lines.append(
            f"| {scene} | {kind} | {found['build_seconds']:.2f} | {found['nodes']:,} | {found['depth']} "
            f"| {found['references']:,} | {found['sah_cost']:.1f} | {counts.nodes.numpy().mean():.1f} "
            f"| {counts.primitives.numpy().mean():.1f} | {speed:.2f} | {speed / speeds[sah]:.2f} |"
        )
    return lines


if __name__ == "__main__":
    main()
