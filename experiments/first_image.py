"""Seconds from the command to the written file: the demo room at 256 x 256, 1 sample a pixel, with an empty and a
filled kernel cache, beside Mitsuba doing the same. Whole processes, in turn, the best of ``--repeat``.

    python experiments/first_image.py -o out/first_image.md
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOM = Path(__file__).parent.parent / "scenes" / "igehy_room.xml"

MITSUBA = """
import sys, os
from raytrace2 import _llvm  # the same libLLVM for both
import mitsuba as mi
mi.set_variant("llvm_ad_rgb")
scene = mi.load_file(sys.argv[1], spp=1)
image = mi.render(scene, spp=1)
mi.Bitmap(image).write(sys.argv[2])
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", nargs="?", default=str(ROOM))
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("-o", "--output", help="write the table there too")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        commands = {
            "raytrace2": [
                sys.executable, "-m", "raytrace2", "render", args.scene, "--size", "256x256", "--spp", "1",
                "-o", f"{folder}/ours.exr",
            ],
            "Mitsuba": [sys.executable, "-c", MITSUBA, args.scene, f"{folder}/theirs.exr"],
        }  # fmt: skip
        seconds: dict[tuple[str, str], float] = {}
        for round_ in range(args.repeat):
            for name, command in commands.items():
                home = Path(folder) / f"{name}-{round_}"
                home.mkdir()
                for cache in ("empty", "filled", "filled"):
                    taken = run(command, home)
                    seconds[name, cache] = min(taken, seconds.get((name, cache), taken))
                shutil.rmtree(home)
    lines = ["| kernel cache | raytrace2, s | Mitsuba, s | ratio |", "|---|---:|---:|---:|"]
    for cache in ("empty", "filled"):
        ours, theirs = seconds["raytrace2", cache], seconds["Mitsuba", cache]
        lines.append(f"| {cache} | {ours:.2f} | {theirs:.2f} | {theirs / ours:.2f} |")
    table = "\n".join(lines)
    print(table)
    if args.output:
        from raytrace2.files import write_atomically

        Path(args.output).parent.mkdir(parents=True, exist_ok=True)
        write_atomically(args.output, (table + "\n").encode())


def run(command: list[str], home: Path) -> float:
    """Seconds that ``command`` takes with its kernel cache below ``home``."""
    begin = time.perf_counter()
    subprocess.run(command, check=True, env={**os.environ, "HOME": str(home)}, stdout=subprocess.DEVNULL)
    return time.perf_counter() - begin


if __name__ == "__main__":
    main()
