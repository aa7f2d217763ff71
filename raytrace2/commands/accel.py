"""``raytrace2 accel show SCENE``: structures drawn over the image, and what their rays cost."""

from __future__ import annotations

import argparse
import io

from ._arguments import add_scene_arguments, load_scene, size_argument


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("action", choices=("show", "names"), help="show: draw structures; names: list their kinds")
    add_scene_arguments(parser, optional=True)
    parser.add_argument("--accel", action="append", help="a structure to draw; may be repeated (default bvh)")
    parser.add_argument("--sensor", type=int, default=0, help="which of the scene's cameras (default 0)")
    parser.add_argument("--size", type=size_argument, metavar="WIDTHxHEIGHT", help="in place of the film's")
    parser.add_argument("-o", "--output", default="accel.png", metavar="PICTURE.png", help="default: accel.png")


def run(args: argparse.Namespace) -> int:
    """Draw, print the statistics of each structure, write the picture."""
    from PIL import Image

    from ..accel import names
    from ..errors import SettingError
    from ..files import write_atomically
    from ..structure_pictures import as_sheet, view_structure

    if args.action == "names":
        print("\n".join(names()))
        return 0
    if args.scene is None:
        raise SettingError("accel show needs a scene file")
    scene = load_scene(args)
    views = []
    for accel in args.accel or ["bvh"]:
        views.append(view_structure(scene, accel, sensor=args.sensor, size=args.size))
        found = scene.traced(accel).structure.statistics()
        counted = f"counted: {views[-1].nodes.mean():.1f} nodes, {views[-1].primitives.mean():.1f} primitives a ray"
        print(", ".join(f"{key} {value}" for key, value in found.items()) + f"; {counted}")
    stream = io.BytesIO()
    Image.fromarray(as_sheet(views)).save(stream, format="PNG")
    write_atomically(args.output, stream.getvalue())
    print(args.output)
    return 0
