"""``raytrace2 accel show SCENE``: structures drawn over the image, and what their rays cost."""

from __future__ import annotations

import argparse
import io
from collections.abc import Callable
from typing import Any

from ._arguments import add_scene_arguments, load_scene, size_argument


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.description = (
        "SCENE is a Mitsuba XML file, or one of rt.scenes.names() with a number of primitives, such as balls:10000."
    )
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
    from ..structure_pictures import as_sheet, look_at

    if args.action == "names":
        print("\n".join(names()))
        return 0
    if args.scene is None:
        raise SettingError("accel show needs a scene: a file, or a name such as balls:10000")
    build, camera = _procedural(args) or _from_file(args)
    views = []
    for accel in args.accel or ["bvh"]:
        structure = build(accel)
        views.append(look_at(structure, camera, accel))
        view = views[-1]
        counted = f"{view.nodes.mean():.1f} nodes, {view.volumes.mean():.1f} volumes, {view.primitives.mean():.1f}"
        found = ", ".join(f"{key} {value}" for key, value in structure.statistics().items())
        print(f"{found}; counted: {counted} primitives a ray")
    stream = io.BytesIO()
    Image.fromarray(as_sheet(views)).save(stream, format="PNG")
    write_atomically(args.output, stream.getvalue())
    print(args.output)
    return 0


def _from_file(args: argparse.Namespace) -> tuple[Callable[[str], Any], Any]:
    """What builds a structure over the scene of a file, and the camera."""
    from ..render import choose_camera

    scene = load_scene(args)
    return lambda accel: scene.traced(accel).structure, choose_camera(scene, args.sensor, args.size)


def _procedural(args: argparse.Namespace) -> tuple[Callable[[str], Any], Any] | None:
    """The same for a procedural scene, if ``SCENE`` names one."""
    from ..accel import build
    from ..errors import SettingError
    from ..scene import procedural

    name, colon, size = args.scene.partition(":")
    if name not in procedural.names():
        return None
    if colon and not size.isdecimal():
        raise SettingError(f"{args.scene!r} should read {name}:NUMBER, such as {name}:10000")
    if args.parameters or args.sensor:
        raise SettingError(f"{name} is made by formula: it takes no -D, and has no camera but 0")
    scene = procedural.make(name, int(size)) if colon else procedural.make(name)

    def make(accel: str) -> Any:
        structure = build(scene, accel)
        structure.prepare()
        return structure

    return make, scene.view.camera(*(args.size or ()))
