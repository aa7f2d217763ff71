"""Ways to have a structure over each frame of an animation, and the seconds they take for the update and for a ray."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import raytrace2 as rt

# isort: split
import drjit as dr
import numpy as np
from animation_meshes import Deformation
from structure_speed import FEW, thinned

from raytrace2.reference.ray_speed import best_times, our_task, secondary_rays
from raytrace2.surfaces.structure import Structure

#: Against what the hits and the times of the others are compared.
NORMAL = "sah"

#: What is built anew in each frame, as --accel takes it.
REBUILT = {"sah": "bvh", "morton": "bvh:builder=morton", "grid": "grid", "hierarchical grid": "hierarchical_grid"}

REFIT, ADAPTIVE = "refit", "refit or sah"

STRATEGIES = (REFIT, ADAPTIVE, *REBUILT)

KINDS = ("primary", "bounce")

Record = dict[str, Any]


class Player:
    """Plays one animation from any frame on; frame 0 is the rest pose."""

    def __init__(self, deformation: Deformation, frames: int, side: int, threshold: float) -> None:
        self.deformation, self.frames, self.threshold = deformation, frames, threshold
        self.primary = rt.Ray(*deformation.view.rays(side, side))
        self._trees: dict[int, rt.accel.Bvh] = {}

    def mesh(self, frame: int) -> rt.TriangleMesh:
        return self.deformation.mesh_at(frame / self.frames)

    def frame(self, number: int, bases: dict[str, int], repeat: int, longest: float) -> Record:
        """What each strategy takes for the frame ``number``. ``bases`` tells in which frame the tree was built that a
        strategy refits; the record's "bases" are those for the next frame."""
        mesh = self.mesh(number)
        built, updates = self._updated(number, mesh, bases, repeat, longest)
        rays, seconds = self._traced(built, repeat, longest)
        found, after = {}, dict(bases)
        for name, structure in built.items():
            said = structure.statistics()
            refit = said.get("refit")
            if name == ADAPTIVE and refit is None:
                after[name] = number
            found[name] = {
                "update": updates[name], "sah_cost": float(said["sah_cost"]), "rebuilt": refit is None,
                "ratio": None if refit is None else float(refit["sah_cost_ratio"]),
                "seconds": {kind: seconds[kind][name] for kind in KINDS},
                "differing": sum(differing(structure, built[NORMAL], ray) for ray in rays.values()),
            }  # fmt: skip
        about = {kind: {"count": len(ray), "hits": hit_share(built[NORMAL], ray)} for kind, ray in rays.items()}
        return {"frame": number, "bases": after, "rays": about, "strategies": found}

    def _updated(
        self, number: int, mesh: rt.TriangleMesh, bases: dict[str, int], repeat: int, longest: float
    ) -> tuple[dict[str, Structure], dict[str, float]]:
        """By strategy, the structure over ``mesh`` and the seconds of its fastest update of ``repeat``, all in turn."""

        def base(name: str) -> rt.accel.Bvh:
            # The first refit of a tree also makes the tables that later ones use: it is timed on a tree without them.
            return self._build(bases[name]) if bases[name] == number - 1 else self._tree(bases[name])

        def adapt(tree: rt.accel.Bvh) -> Structure:
            moved = tree.refit(mesh)
            good = moved.statistics()["refit"]["sah_cost_ratio"] <= self.threshold
            return moved if good else rt.accel.build(mesh, REBUILT[NORMAL])

        jobs: dict[str, tuple[Callable[[], Any], Callable[[Any], Structure]]] = {
            REFIT: (lambda: base(REFIT), lambda tree: tree.refit(mesh)),
            ADAPTIVE: (lambda: base(ADAPTIVE), adapt),
        }
        for name, kind in REBUILT.items():
            jobs[name] = (lambda: None, lambda _, kind=kind: rt.accel.build(mesh, kind))
        best, built, end = dict.fromkeys(jobs, np.inf), {}, np.inf
        for turn in range(repeat + 1):
            for name, (prepare, update) in jobs.items():
                given = prepare()
                dr.sync_thread()
                begin = time.perf_counter()
                built[name] = update(given)
                dr.sync_thread()
                # The first run compiles.
                if turn:
                    best[name] = min(best[name], time.perf_counter() - begin)
            if turn == 0:
                end = time.perf_counter() + longest
            elif time.perf_counter() > end:
                break
        return built, best

    def _traced(
        self, built: dict[str, Structure], repeat: int, longest: float
    ) -> tuple[dict[str, rt.Ray], dict[str, dict[str, float]]]:
        """The rays of each kind, and the seconds of one of them by kind and strategy; fewer rays for all where they
        would take a strategy too long."""
        rays = {"primary": self.primary, "bounce": secondary_rays(built[NORMAL], self.primary, up=2)["bounce"]}
        dr.eval(rays)
        few = thinned(rays, FEW)
        seconds = {}
        for kind in KINDS:
            probe = best_times({n: our_task(s, few[kind], False) for n, s in built.items()}, 1)
            if max(probe.values()) * len(rays[kind]) / FEW > longest / 4:
                rays[kind] = few[kind]
            count = len(rays[kind])
            best = best_times({n: our_task(s, rays[kind], False) for n, s in built.items()}, repeat, longest)
            seconds[kind] = {name: value / count for name, value in best.items()}
        return rays, seconds

    def _build(self, frame: int) -> rt.accel.Bvh:
        tree = rt.accel.build(self.mesh(frame), REBUILT[NORMAL])
        assert isinstance(tree, rt.accel.Bvh)
        return tree

    def _tree(self, frame: int) -> rt.accel.Bvh:
        """The tree of a frame, kept with the tables that its refits made."""
        if frame not in self._trees:
            self._trees[frame] = self._build(frame)
        return self._trees[frame]


def hit_share(structure: Structure, ray: rt.Ray) -> float:
    return float(np.mean(np.isfinite(structure.intersect(ray).t.numpy())))


def differing(structure: Structure, normal: Structure, ray: rt.Ray) -> int:
    """On how many rays the primitive or any bit of t differs."""
    a, b = structure.intersect(ray), normal.intersect(ray)
    dr.eval(a, b)
    t = a.t.numpy().view(np.uint32) != b.t.numpy().view(np.uint32)
    return int(np.count_nonzero(t | (a.prim.numpy() != b.prim.numpy())))


def first_bases() -> dict[str, int]:
    return {REFIT: 0, ADAPTIVE: 0}


def mean(records: Sequence[Record], strategy: str, what: str, kind: str = "") -> float:
    """The mean over frames of a strategy's seconds."""
    values = [r["strategies"][strategy][what] for r in records]
    return float(np.mean([v[kind] if kind else v for v in values]))
