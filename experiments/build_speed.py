"""How long does a hierarchy take to build? Seconds and triangles per second for a terrain by formula and, if given, a
mesh file, beside Mitsuba's load of a scene with the same mesh (which builds Embree's hierarchy) in the same process, in
turn.

    python experiments/build_speed.py [MESH.ply|MESH.obj] [--builder sah] [--builder morton] [--triangles 1000000]
        [--repeat 5] [-o out/build_speed.md]

'arrays' starts from vertices and faces in memory: a TriangleMesh and the structure over it, against mi.load_dict of a
scene with a mi.Mesh. 'file' starts from a ply or obj file, reading included. 'cold' is the first build of the process,
which also fetches kernels from Dr.Jit's cache, or compiles them where there is none.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import raytrace2  # noqa: F401  settles libLLVM before anything imports drjit

# isort: split
import drjit as dr
import numpy as np

from raytrace2.accel import build
from raytrace2.files import write_atomically
from raytrace2.reference.mitsuba_scene import mitsuba_variant
from raytrace2.scene.mesh_files import load_mesh_file
from raytrace2.scene.procedural import terrain
from raytrace2.surfaces.mesh import TriangleMesh


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("mesh", nargs="?", type=Path, help="a mesh file to measure after the terrain")
    parser.add_argument("--triangles", type=float, default=1e6, help="of the terrain")
    parser.add_argument("--repeat", type=int, default=5, help="runs of each, of which the best counts")
    parser.add_argument("--builder", action="append", help="of the bvh; may be repeated (default sah)")
    parser.add_argument("-o", "--output", type=Path, help="write the table there too")
    arguments = parser.parse_args()
    lines = [
        "| mesh | from | builder | triangles | cold, s | raytrace2, s | Mitsuba, s | Mtri/s | ratio | nodes | depth "
        "| SAH cost |",
        "|---|---|---|" + "---:|" * 9,
    ]
    print("\n".join(lines))
    with mitsuba_variant("llvm_ad_rgb") as mi, tempfile.TemporaryDirectory() as folder:
        mesh = terrain(int(arguments.triangles))
        path = Path(folder) / "terrain.ply"
        _mitsuba_mesh(mi, mesh).write_ply(str(path))
        for builder in arguments.builder or ["sah"]:
            lines += _measure_both(mi, mesh, path, builder, arguments.repeat)
            if arguments.mesh is not None:
                lines += _measure_both(mi, _read(arguments.mesh), arguments.mesh, builder, arguments.repeat)
    if arguments.output is not None:
        arguments.output.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(arguments.output, ("\n".join(lines) + "\n").encode())


def _measure_both(mi: Any, mesh: TriangleMesh, path: Path, builder: str, repeat: int) -> list[str]:
    theirs = _mitsuba_mesh(mi, mesh)
    shape = {"type": path.suffix[1:], "filename": str(path)}
    arrays = _row(
        mesh,
        "arrays",
        builder,
        repeat,
        lambda: build(TriangleMesh(mesh.vertices, mesh.faces), builder=builder),
        lambda: mi.load_dict({"type": "scene", "mesh": theirs}),
    )
    from_file = _row(
        mesh, "file", builder, repeat,
        lambda: build(_read(path), builder=builder),
        lambda: mi.load_dict({"type": "scene", "mesh": shape}),
    )  # fmt: skip
    return [arrays, from_file]


def _row(
    mesh: TriangleMesh, source: str, builder: str, repeat: int, ours: Callable[[], Any], theirs: Callable[[], Any]
) -> str:
    cold, structure = _timed(ours)
    times = np.array([[_timed(ours)[0], _timed(theirs)[0]] for _ in range(repeat)]).min(axis=0)
    found = structure.statistics()
    n = len(mesh.faces)
    line = (
        f"| {mesh.name} | {source} | {builder} | {n:,} | {cold:.2f} | {times[0]:.3f} | {times[1]:.3f} "
        f"| {n / times[0] / 1e6:.2f} "
        f"| {times[1] / times[0]:.2f} | {found['nodes']:,} | {found['depth']} | {found['sah_cost']:.1f} |"
    )
    print(line, flush=True)
    return line


def _timed(task: Callable[[], Any]) -> tuple[float, Any]:
    begin = time.perf_counter()
    made = task()
    dr.sync_thread()
    return time.perf_counter() - begin, made


def _read(path: Path) -> TriangleMesh:
    data = load_mesh_file(path, "obj" if path.suffix == ".obj" else "ply", face_normals=True)
    return TriangleMesh(data.vertices, data.faces, name=path.stem)


def _mitsuba_mesh(mi: Any, mesh: TriangleMesh) -> Any:
    made = mi.Mesh("mesh", len(mesh.vertices), len(mesh.faces))
    buffers = mi.traverse(made)
    buffers["vertex_positions"] = mesh.vertices.ravel().astype(np.float32)
    buffers["faces"] = mesh.faces.ravel()
    buffers.update()
    return made


if __name__ == "__main__":
    main()
