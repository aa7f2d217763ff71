"""``raytrace2 render SCENE -o OUT.exr``: a scene file to an image file."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from ._arguments import add_render_arguments, add_scene_arguments, load_scene, render_options


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    add_scene_arguments(parser)
    parser.add_argument(
        "-o", "--output", default=None, metavar="FILE", help="an .exr or .png file (default: SCENE.exr)"
    )
    parser.add_argument("--spp", type=int, default=0, help="samples per pixel (default: the scene's)")
    add_render_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Render and write the file; after Ctrl-C write what was done and return 130."""
    from ..errors import RayTraceError
    from ..render import RenderInterrupted, render_detailed

    output = Path(args.output or Path(args.scene).with_suffix(".exr").name)
    if output.suffix.lower() not in (".exr", ".png"):
        raise RayTraceError(f"{output}: images are written as .exr or .png")
    if args.spp < 0:
        raise RayTraceError(f"--spp {args.spp}: samples per pixel cannot be negative")
    scene = load_scene(args)
    options = render_options(args)
    try:
        rendering = render_detailed(scene, spp=args.spp, **options)
    except RenderInterrupted as stop:
        if stop.partial is None:
            raise
        _write(output, scene, stop.partial, {**options, "interrupted": True})
        print(f"raytrace2: interrupted; {output} holds what was done", file=sys.stderr)
        return 130
    _write(output, scene, rendering, options)
    seconds = f"{rendering.seconds:.2f} s, {rendering.prepare_seconds:.2f} s to prepare"
    print(f"{output}: {rendering.image.shape[1]} x {rendering.image.shape[0]}, {rendering.spp} spp, {seconds}")
    return 0


def _write(output: Path, scene: Any, rendering: Any, options: dict[str, Any]) -> None:
    import numpy as np

    from ..image_io import write_exr, write_png
    from ..provenance import provenance

    image = np.array(rendering.image)
    if output.suffix.lower() == ".exr":
        write_exr(output, image, rendering.channels, provenance(scene, rendering, options))
    else:
        count = 3 if image.shape[2] >= 3 else 1
        write_png(output, image[..., :count])
        if left := rendering.channels[count:]:
            print(f"{output}: without {', '.join(left)}: a name that ends in .exr keeps them", file=sys.stderr)
