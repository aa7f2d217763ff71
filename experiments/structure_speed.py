"""What studies of structures measure: builds, rays per second beside the default hierarchy and Mitsuba, counters."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, get_args

import raytrace2 as rt

# isort: split
import drjit as dr
import numpy as np

from raytrace2.accel.bvh_config import Builder
from raytrace2.reference.ray_speed import best_times, mitsuba_meshes, mitsuba_tasks, our_task, secondary_rays
from raytrace2.scene.procedural import ProceduralScene
from raytrace2.surfaces.structure import Structure

RAY_KINDS = ("primary", "bounce", "shadow")

#: Against what everything is timed in turn, so that what else the machine does falls on both.
NORMAL = "bvh"

#: Rays for structures that are too slow for all of them: two of the blocks that Dr.Jit gives to threads.
FEW = 2 * 16384

#: Structures of a kind that are compared; a kind that is not here stands as it is by default.
VARIANTS = {
    "bounding_volumes": [f"bounding_volumes:volume={v}" for v in ("sphere", "box", "oriented_box")],
    "bvh": [
        "bvh",
        *(f"bvh:builder={b}" for b in get_args(Builder) if b != "sah"),
        *(f"bvh:{option}" for option in ("width=2", "width=8", "volume=sphere", "volume=oriented_box")),
    ],
    "hierarchical_grid": ["hierarchical_grid", "hierarchical_grid:levels=3"],
}


def structures(words: Sequence[str] = ()) -> list[str]:
    """Every structure there is, with its variants, whose name contains any of ``words``."""
    found = [name for kind in rt.accel.names() for name in VARIANTS.get(kind, [kind])]
    chosen = [name for name in found if not words or any(word in name for word in words)]
    if not chosen:
        raise SystemExit(f"no structure's name contains {' or '.join(words)}; there are {', '.join(found)}")
    return chosen


def tracing_digest() -> str:
    """Changes with every line that these measurements depend on: those of other code are not resumed."""
    root = Path(rt.__file__).parent
    parts = [root / name for name in ("accel", "surfaces", "rays", "scene/procedural")]
    files = [f for part in parts for f in part.rglob("*.py")]
    digest = hashlib.sha256()
    for file in sorted([*files, root / "buffers.py", root / "types.py", root / "reference/ray_speed.py"]):
        digest.update(str(file.relative_to(root)).encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]


def rays_of(scene: ProceduralScene, structure: Structure, side: int) -> dict[str, rt.Ray]:
    """The three kinds of rays: ``side`` x ``side`` primary ones from the scene's view, and what follows from them."""
    primary = rt.Ray(*scene.view.rays(side, side))
    found = {"primary": primary, **secondary_rays(structure, primary, up=2)}
    dr.eval(found)
    return found


def thinned(rays: dict[str, rt.Ray], count: int) -> dict[str, rt.Ray]:
    """``count`` rays of each kind, evenly spread over those there are."""
    found = {}
    for kind, ray in rays.items():
        index = np.linspace(0, len(ray), count, endpoint=False).astype(np.uint32)
        o, d, tmin, tmax = (np.array(v).T for v in (ray.o, ray.d, ray.tmin, ray.tmax))
        limits = [v if v.size == 1 else v[index] for v in (tmin, tmax)]
        found[kind] = rt.Ray(o[index], d[index], *limits)
    dr.eval(found)
    return found


def timed_build(scene: ProceduralScene, name: str, longest: float) -> tuple[Structure, float]:
    """The structure and the seconds of its fastest build: of three, or of one if that took ``longest`` seconds."""
    best, spent = np.inf, 0.0
    for _ in range(3):
        begin = time.perf_counter()
        structure = rt.accel.build(scene, name)
        dr.sync_thread()
        seconds = time.perf_counter() - begin
        best, spent = min(best, seconds), spent + seconds
        if spent > longest:
            break
    return structure, best


def counters(structure: Structure, ray: rt.Ray) -> dict[str, float]:
    """Means over the rays of volumes, nodes and primitives tested by their closest hit, and the share that has one."""
    hit, counts = structure.count(ray)
    dr.eval(hit, counts)
    means = {name: float(np.mean(np.array(getattr(counts, name)))) for name in ("volumes", "nodes", "primitives")}
    return {**means, "hits": float(np.mean(np.isfinite(np.array(hit.t))))}


class Bench:
    """One scene with its rays, the default hierarchy and, where it has triangles alone, Mitsuba's scene of it."""

    def __init__(self, mi: Any, scene: ProceduralScene, side: int, repeat: int, longest: float) -> None:
        self.scene, self.repeat, self.longest = scene, repeat, longest
        self.normal = rt.accel.build(scene, NORMAL)
        self.rays = rays_of(scene, self.normal, side)
        self.few = thinned(self.rays, FEW)
        self._mi = mi
        meshes = [s for s in scene if isinstance(s, rt.TriangleMesh)]
        self._theirs = mitsuba_meshes(mi, meshes) if len(meshes) == len(scene) else None

    def speeds(self, structure: Structure) -> dict[str, dict[str, Any]]:
        """By kind of ray: how many there were, rays per second of the structure, of the default hierarchy and of
        Mitsuba (None where it takes no part), timed in turn, and what the rays met on the way."""
        probe = best_times({"": our_task(structure, self.few["bounce"], False)}, 1)[""]
        # The runs of one kind of ray should not take much longer than what was asked for.
        rays = self.rays if 3 * probe * len(self.rays["primary"]) / FEW < self.longest else self.few
        return {kind: self._speed(structure, ray, kind == "shadow") for kind, ray in rays.items()}

    def _speed(self, structure: Structure, ray: rt.Ray, shadow: bool) -> dict[str, Any]:
        tasks: dict[Any, Callable[[], Any]] = {"ours": our_task(structure, ray, shadow)}
        tasks["normal"] = our_task(self.normal, ray, shadow)
        if self._theirs is not None:
            tasks |= mitsuba_tasks(self._mi, self._theirs, ray, shadow)
        best = best_times(tasks, self.repeat, self.longest)
        count = len(ray)
        theirs = None if self._theirs is None else count / min(best[True], best[False])
        found = {"count": count, "rate": count / best["ours"], "normal": count / best["normal"], "mitsuba": theirs}
        return found | counters(structure, ray)
