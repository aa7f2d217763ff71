"""Refit, rebuild or build a grid? Over the frames of meshes that deform, gently and violently, every way to keep a
structure up to date: seconds of the update, rays per second, the quality that a refit reports; so which way is cheapest
at which number of rays per frame, and where they cross.

    python experiments/animation.py [--triangles 100000] [--frames 12] [--threshold 1.5] [--animations wave burst]
                                    [--quick] [-o out/animation.md]

Ways: refit the rest pose's sah hierarchy in every frame; refit, or build where the reported ratio passes the threshold;
build a hierarchy (sah or morton), a grid or a grid of grids in every frame. All take turns. Hits must be the same to
the bit. Writes a table and a picture beside it (.png). Interrupted, it goes on where it was, by frame; measurements of
other code or settings are made anew.
"""

from __future__ import annotations

import argparse
import hashlib
import platform
import sys
from pathlib import Path
from typing import Any

import animation_meshes
import animation_updates
from animation_chart import picture
from animation_costs import crossover_table, frame_table, refit_table, strategy_table, winner_table
from animation_meshes import DEFORMATIONS
from animation_updates import ADAPTIVE, KINDS, NORMAL, REFIT, Player, Record, first_bases
from structure_speed import tracing_digest
from study import read_json, save_image, save_json, save_text
from tqdm import tqdm


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--triangles", type=float, default=1e5, help="of each mesh, about (default 100000)")
    parser.add_argument("--frames", type=int, default=12, help="after the rest pose (default 12)")
    parser.add_argument("--threshold", type=float, default=1.5, help="ratio of expected costs above which "
                        f"'{ADAPTIVE}' builds (default 1.5)")  # fmt: skip
    parser.add_argument("--side", type=int, default=512, help="primary rays along a side of the image (default 512)")
    parser.add_argument("--repeat", type=int, default=5, help="runs of which the best counts (default 5)")
    parser.add_argument("--longest", type=float, default=2.0, help="seconds after which runs are not repeated, and "
                        "which a strategy may take before all get fewer rays (default 2)")  # fmt: skip
    parser.add_argument("--animations", nargs="*", default=list(DEFORMATIONS), choices=DEFORMATIONS, metavar="NAME",
                        help=f"of {', '.join(DEFORMATIONS)}")  # fmt: skip
    parser.add_argument("--quick", action="store_true", help="small meshes, few frames, few runs")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/animation.md"))
    options = parser.parse_args()
    if options.quick:
        options.triangles, options.frames, options.side, options.repeat = 1e4, 4, 256, 2
    if options.frames < 1 or options.repeat < 1:
        parser.error("--frames and --repeat must be at least 1")
    sources = b"".join(Path(str(m.__file__)).read_bytes() for m in (animation_meshes, animation_updates))
    settings = {"code": tracing_digest(), "study": hashlib.sha256(sources).hexdigest()[:16], "machine": platform.node()}
    settings |= {k: getattr(options, k) for k in ("triangles", "frames", "threshold", "side", "repeat", "longest")}
    animations: dict[str, list[Record]] = {}
    with tqdm(total=len(options.animations) * options.frames, unit="frame", disable=None) as bar:
        for name in options.animations:
            for record in played(name, settings, options):
                animations.setdefault(name, []).append(record)
                bar.update()
                tqdm.write(line(name, record))
                write(options.output, animations, settings)
    wrong = sum(s["differing"] for records in animations.values() for r in records for s in r["strategies"].values())
    print(f"written: {options.output}, {options.output.with_suffix('.png')}; {wrong} hits differ")
    return int(wrong > 0)


def played(name: str, settings: dict[str, Any], options: argparse.Namespace) -> Any:
    """The records of one animation, frame by frame; those that are there already are only read."""
    player, bases = None, first_bases()
    for number in range(1, options.frames + 1):
        file = options.output.with_suffix("") / f"{options.triangles:g}" / name / f"{number}.json"
        record = read_json(file)
        if record is None or record["settings"] != settings:
            if player is None:
                deformation = DEFORMATIONS[name](int(options.triangles))
                player = Player(deformation, options.frames, options.side, options.threshold)
            record = player.frame(number, bases, options.repeat, options.longest)
            record |= {"settings": settings, "triangles": player.deformation.rest.primitive_count}
            record |= {"about": player.deformation.about}
            save_json(file, record)
        bases = record["bases"]
        yield record


def line(name: str, record: Record) -> str:
    of = record["strategies"]
    said = "  ".join(f"{s} {v['update'] * 1e3:.1f} ms, {1e-6 / v['seconds']['bounce']:.2f} M/s" for s, v in of.items())
    return f"{name} {record['frame']:2d}: ratio {of[REFIT]['ratio']:.2f}  {said}"


def write(output: Path, animations: dict[str, list[Record]], settings: dict[str, Any]) -> None:
    """The tables and the picture of what is there so far."""
    about = (
        f"Means over {settings['frames']} frames after the rest pose. '{REFIT}': the hierarchy of the rest pose (sah) "
        f"is refitted in every frame; '{ADAPTIVE}': refitted, and built anew in frames whose reported ratio passes "
        f"{settings['threshold']:g}; the others are built in every frame. A frame costs its update and its rays by the "
        f"time of a ray (closest hits, all of one kind); making the mesh's arrays, the same for all, is left out. In "
        f"brackets, how much dearer the runner-up is. 'handed over': from how many rays a frame another is cheapest. "
        f"Where '{ADAPTIVE}' built in no frame or in all, it is '{REFIT}' or '{NORMAL}' and takes no part.\n"
    )
    meshes = "".join(
        f"- {name}: {records[0]['about']}; {records[0]['triangles']:,} triangles; in the last frame "
        + ", ".join(f"{records[-1]['rays'][k]['hits']:.0%} of {k} rays hit" for k in KINDS) + "\n"
        for name, records in animations.items()
    )  # fmt: skip
    text = f"# Refit against rebuild\n\n## Cheapest\n\n{about}\n{winner_table(animations)}\n{meshes}\n"
    text += (
        f"## Crossovers\n\nThe cheaper of each two below and above the number of rays per frame at which they cost the "
        f"same.\n\n{crossover_table(animations)}\n## Strategies\n\nUpdates and rays are the best of "
        f"{settings['repeat']} runs, all strategies in turn; hits are compared with those of '{NORMAL}', primitive and "
        f"bits of t.\n\n{strategy_table(animations)}\n## Refits\n\nThe first refit of a tree also makes tables that "
        f"later ones use. The reported ratio is of the expected cost now to that when the tree was built.\n\n"
        f"{refit_table(animations)}\n## Frames\n\nUnder the strategies: update in ms / primary / bounce Mrays/s.\n\n"
    )
    for name, records in animations.items():
        text += f"### {name}\n\n{frame_table(records)}\n"
    save_text(output, text)
    title = f"A frame's update and rays, {settings['triangles']:g} triangles, means over frames"
    save_image(output.with_suffix(".png"), picture(animations, title))


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit("interrupted: the same command goes on from here")
