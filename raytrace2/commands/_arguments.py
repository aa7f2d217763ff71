"""Arguments that several commands share. Flags bear the names of the Python arguments."""

from __future__ import annotations

import argparse
from typing import Any


def add_scene_arguments(parser: argparse.ArgumentParser, *, optional: bool = False) -> None:
    """The scene file and the values of its parameters."""
    parser.add_argument("scene", metavar="SCENE", nargs="?" if optional else None, help="a Mitsuba XML file")
    parser.add_argument(
        "-D",
        dest="parameters",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        help="fill in a $parameter of the scene",
    )


def add_render_arguments(parser: argparse.ArgumentParser) -> None:
    """What ``rt.render`` takes."""
    parser.add_argument("--sensor", type=int, default=0, help="which of the scene's cameras (default 0)")
    parser.add_argument("--integrator", help="path, direct or aov:KIND,KIND; the scene's own by default")
    parser.add_argument("--seed", type=int, default=0, help="of the sampler (default 0)")
    parser.add_argument("--accel", help="acceleration structure, such as bvh or bvh:max_leaf_size=2")
    parser.add_argument("--filter", help="texture filter, such as ewa or exact, in place of every bitmap's own")
    parser.add_argument("--differentials", help="how rays know their footprints, such as autodiff or cone")
    add_intersection_argument(parser)
    parser.add_argument("--precision", default="float32", choices=("float32", "float64"))
    parser.add_argument("--size", type=size_argument, metavar="WIDTHxHEIGHT", help="in place of the film's")


def add_intersection_argument(parser: argparse.ArgumentParser) -> None:
    """How rays meet triangles."""
    parser.add_argument(
        "--intersection",
        choices=("watertight", "fast"),
        help="watertight: no ray slips between triangles; fast: quicker, not exact at edges (default: the scene's "
        "own, or watertight)",
    )


def load_scene(args: argparse.Namespace) -> Any:
    """The scene that ``args`` name."""
    from ..errors import RayTraceError
    from ..load import load_file

    parameters = {}
    for item in args.parameters:
        name, equals, value = item.partition("=")
        if not equals or not name:
            raise RayTraceError(f"-D {item}: write -D NAME=VALUE")
        parameters[name] = value
    return load_file(args.scene, **parameters)


def render_options(args: argparse.Namespace) -> dict[str, Any]:
    """The keyword arguments for ``rt.render``."""
    names = ("sensor", "integrator", "seed", "accel", "filter", "differentials", "precision", "size", "intersection")
    return {name: getattr(args, name) for name in names}


def size_argument(text: str) -> tuple[int, int]:
    """``WIDTHxHEIGHT`` as a pair, for argparse."""
    width, _, height = text.lower().partition("x")
    try:
        size = int(width), int(height)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} should read WIDTHxHEIGHT, such as 640x480") from None
    if min(size) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} has no pixels")
    return size
