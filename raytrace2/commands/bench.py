"""``raytrace2 bench``: rays per second beside Mitsuba and Embree."""

from __future__ import annotations

import argparse
from pathlib import Path

from ._arguments import add_intersection_argument


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "mesh", nargs="?", metavar="MESH", help="a .ply or .obj file (default: a bumpy sphere by formula)"
    )
    parser.add_argument("--triangles", type=int, default=70_000, help="of the bumpy sphere (default 70000)")
    parser.add_argument("--accel", action="append", help="a structure to measure; may be repeated (default bvh)")
    add_intersection_argument(parser)
    parser.add_argument(
        "--side", type=int, default=1024, help="primary rays along each side of the image (default 1024)"
    )
    parser.add_argument("--repeat", type=int, default=15, help="runs of which the best counts (default 15)")
    parser.add_argument("-o", "--output", metavar="TABLE.md", help="write the table there too")


def run(args: argparse.Namespace) -> int:
    """Measure, print the table, and write it if asked to."""
    from ..errors import RayTraceError
    from ..files import write_atomically
    from ..reference.ray_speed import as_table, ray_speed
    from ..scene.mesh_files import load_mesh_file
    from ..scene.procedural import bumpy_sphere
    from ..surfaces.mesh import TriangleMesh

    for name in ("triangles", "side", "repeat"):
        if getattr(args, name) < 1:
            raise RayTraceError(f"--{name} must be at least 1")
    if args.mesh:
        ending = Path(args.mesh).suffix.lower()
        if ending not in (".ply", ".obj"):
            raise RayTraceError(f"{args.mesh}: the benchmark reads .ply and .obj meshes")
        data = load_mesh_file(args.mesh, "ply" if ending == ".ply" else "obj")
        mesh = TriangleMesh(data.vertices, data.faces, name=Path(args.mesh).stem)
    else:
        mesh = bumpy_sphere(args.triangles)
    print(f"{mesh.name}: {len(mesh.faces):,} triangles")
    rows = ray_speed(
        mesh,
        args.accel or ["bvh"],
        side=args.side,
        repeat=args.repeat,
        intersection=args.intersection or "watertight",
    )
    table = as_table(rows)
    print(table)
    if args.output:
        Path(args.output).parent.mkdir(parents=True, exist_ok=True)
        write_atomically(args.output, (table + "\n").encode())
    return 0
