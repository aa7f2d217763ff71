"""``raytrace2 stability``: what goes wrong at the extremes, counted, beside Mitsuba and Embree."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.description = (
        "Counts leaks, self-hits and errors at the extremes in both precisions, and for Mitsuba in the same run. Small "
        "counts and the default structure take a minute or so; experiments/stability.py has all in full."
    )
    parser.add_argument(
        "--accel", action="append", help="a structure to measure, or all; may be repeated (default bvh)"
    )
    parser.add_argument("--only", action="append", default=[], metavar="WORD", help="figures whose key has this word")
    parser.add_argument(
        "--rays", type=int, default=200_000, help="rays at vertices, edges and at random (default 200000)"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", "--output", default="out/stability", metavar="FOLDER", help="default: out/stability")


def run(args: argparse.Namespace) -> int:
    """Measure, print the scoreboard, write table and picture."""
    from dataclasses import replace

    from ..accel import names
    from ..accel.build import parse_kind
    from ..errors import RayTraceError
    from ..stability.report import measure_and_write
    from ..stability.sweep import Counts

    if args.rays < 1:
        raise RayTraceError("--rays must be at least 1")
    kinds = [k for kind in args.accel or ["bvh"] for k in (names() if kind == "all" else [kind])]
    for kind in kinds:
        parse_kind(kind)
    base = Counts()
    counts = replace(base, aimed=args.rays, random=args.rays, other=min(args.rays, base.other), seed=args.seed)
    folder = Path(args.output)
    text = measure_and_write(list(dict.fromkeys(kinds)), counts, folder, args.only)
    print(text.partition("## By structure")[0].strip())
    print(f"\n{folder / 'stability.md'}, {folder / 'stability.png'}")
    return 0
