"""``raytrace2 compare SCENE``: our image beside Mitsuba's, as figures and as a web page."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ._arguments import add_render_arguments, add_scene_arguments, load_scene, render_options


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    add_scene_arguments(parser)
    parser.add_argument(
        "-o", "--output", default=None, metavar="PAGE.html", help="the page to write (default: SCENE.html)"
    )
    parser.add_argument("--spp", type=int, default=64, help="samples per pixel of ours (default 64)")
    parser.add_argument("--reference-spp", type=int, default=None, help="of Mitsuba's (default: as many)")
    parser.add_argument("--cache-dir", default=None, help="where references are kept")
    add_render_arguments(parser)
    limits = parser.add_argument_group("limits past which the exit status is 1")
    limits.add_argument("--max-rmse", type=float, metavar="X")
    limits.add_argument("--max-relmse", type=float, metavar="X")
    limits.add_argument("--max-flip", type=float, metavar="X")
    limits.add_argument("--only-noise", action="store_true", help="the two may differ by no more than noise")


def run(args: argparse.Namespace) -> int:
    """Compare, print the figures, write the page; 1 if a limit is passed."""
    from ..compare import compare

    scene = load_scene(args)
    output = Path(args.output or Path(args.scene).with_suffix(".html").name)
    result = compare(
        scene, spp=args.spp, reference_spp=args.reference_spp, cache_dir=args.cache_dir, **render_options(args)
    )
    return finish(result, output, args)


def finish(result: Any, output: Path, args: argparse.Namespace) -> int:
    """Prints the figures of ``result``, writes its page and says which of the limits in ``args`` it passes."""
    width = max(map(len, result.figures()))
    for name, value in result.figures().items():
        print(f"{name:<{width}}  {value}")
    verdict = {None: "not tested", True: "no", False: "yes: " + "; ".join(result.noise.reasons if result.noise else ())}
    print(f"{'Differ by more than noise?':<{width}}  {verdict[result.consistent]}")
    print(f"{'Page':<{width}}  {result.report(output)}")
    passed = [
        f"{name} {value:.4g} is more than {limit:g}"
        for name, value, limit in (
            ("RMSE", result.rmse, args.max_rmse),
            ("relMSE", result.relmse, args.max_relmse),
            ("FLIP", result.flip, args.max_flip),
        )
        if limit is not None and not value <= limit
    ]
    if args.only_noise and result.consistent is False:
        passed.append("the two differ by more than noise")
    for line in passed:
        print(f"Limit passed: {line}")
    return 1 if passed else 0
