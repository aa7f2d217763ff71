"""The ``raytrace2`` command: finds the sub-command, and turns errors into one line and an exit status.

Exit status: the sub-command's own (0 or 1); 2 for wrong usage or an error in the input or the environment; 130 after
Ctrl-C; 141 when the reader of a pipe has gone.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence
from types import ModuleType

from . import _llvm
from .errors import RayTraceError

# Each is a module of raytrace2.commands, imported only when it is the one asked for.
COMMANDS = {
    "render": "a scene file to an image file",
    "compare": "our image of a scene beside Mitsuba's, as figures and as a web page",
    "demo": "the room of Igehy's paper, rendered and compared",
    "accel": "structures drawn over the image of a scene, and what their rays cost",
    "stability": "what goes wrong at the extremes, counted for every structure beside Mitsuba and Embree",
    "bench": "rays per second beside Mitsuba and Embree, on the same rays in the same process",
    "doctor": "what this machine has, and whether a ray can be traced with it",
}

# These must run, and say why, where nothing else can.
_WITHOUT_LLVM = frozenset({"doctor"})


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line ``argv`` (by default this process's own) and return its exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    name = next((word for word in words if not word.startswith("-")), None)
    module = importlib.import_module(f".commands.{name}", __package__) if name in COMMANDS else None
    args = _parser(name, module).parse_args(words)
    if module is None:
        return 2
    try:
        if name not in _WITHOUT_LLVM:
            _llvm.require()
        status: int = module.run(args)
        sys.stdout.flush()
        return status
    except RayTraceError as error:
        print(f"raytrace2: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("raytrace2: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # The interpreter flushes stdout once more as it ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141


def _parser(name: str | None, module: ModuleType | None) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="raytrace2", description="A differentiable ray tracer for the study of rendering."
    )
    parser.add_argument("--version", action="version", version=f"raytrace2 {_version()}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for command, summary in COMMANDS.items():
        sub = commands.add_parser(command, help=summary, description=summary[0].upper() + summary[1:] + ".")
        if command == name and module is not None:
            module.add_arguments(sub)
    return parser


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("raytrace2")
    except PackageNotFoundError:
        return "(not installed)"
