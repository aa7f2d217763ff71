"""``raytrace2 demo``: the room of Igehy's paper, rendered, compared with Mitsuba, and shown as a web page."""

from __future__ import annotations

import argparse
from pathlib import Path

from .compare import finish


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("-o", "--output", default="out", metavar="FOLDER", help="where the files go (default: out)")
    parser.add_argument("--spp", type=int, default=64, help="samples per pixel on either side (default 64)")
    parser.set_defaults(max_rmse=None, max_relmse=None, max_flip=None, only_noise=True)


def run(args: argparse.Namespace) -> int:
    """Render, compare, write ``room.html``, ``room.exr`` and ``room.png``; 1 if the two differ by more than noise."""
    from ..compare import compare
    from ..errors import RayTraceError
    from ..image_io import write_exr, write_png
    from ..load import load_file

    package = Path(__file__).parent.parent
    places = [package / "_scenes" / "igehy_room.xml", package.parent / "scenes" / "igehy_room.xml"]
    scene_file = next((p for p in places if p.is_file()), None)
    if scene_file is None:
        raise RayTraceError("the demo's scene was not installed with raytrace2; reinstall it with pip")
    output = Path(args.output)
    output.mkdir(parents=True, exist_ok=True)
    scene = load_file(scene_file)
    result = compare(scene, spp=args.spp)
    write_png(output / "room.png", result.ours)
    header = {f"raytrace2.{key}": value for key, value in {**result.settings, **result.figures()}.items()}
    write_exr(
        output / "room.exr", result.ours, ["R", "G", "B"], {**header, "raytrace2.scene_hash": scene.description.hash}
    )
    return finish(result, output / "room.html", args)
