"""Do later steps of an optimisation compile anything, and do they keep anything? For every kind of parameter.

    python experiments/steps.py [--only WORD ...] [--steps 200] [--long 1000] [-o out/steps.md]

Each case renders an image of a few pixels, takes a gradient and makes a step of Adam, so many times; where steps are
quick it goes on to the long run. Counted are the kernels that Dr.Jit had to compile or to read from its cache on the
disk, in the first two steps and in all later ones, the arrays that are alive after a step, and the memory of the
process. Cases that are done are not done again as long as the program is the same. Exit status 1 if a later step
compiled anything.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import raytrace2 as rt  # isort: skip  # before drjit
import drjit as dr
import numpy as np
from study import code_digest, markdown_table, read_json, save_json, save_text
from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "gradients"))

import gradient_scenes as scenes

#: Long runs are for steps of less than this many seconds.
QUICK = 0.03
FLOOR = "floor.bsdf.reflectance.data"
HEAD = (
    "parameter", "with", "kernels, steps 1 and 2", "compiled later", "arrays at step 10", "at the end",
    "MB at step 100", "at the end", "steps", "ms a step",
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """The parameter ``key`` of the scene with other ``things``, and how it is rendered. ``pyramid``: levels of detail
    are optimised instead of texels; ``torn``: vertices fly apart besides, so that hierarchies are built anew. ``what``
    names the other things."""

    key: str
    how: dict[str, Any] = field(default_factory=dict)
    things: Callable[[], dict[str, Any]] = dict
    rate: float = 1e-3
    pyramid: bool = False
    torn: bool = False
    what: str = ""

    @property
    def words(self) -> tuple[str, str]:
        """The first two columns of the table."""
        how = [f"{k}={v}" for k, v in self.how.items()]
        more = [self.what] * bool(self.what) + ["Laplacian pyramid"] * self.pyramid + ["flying apart"] * self.torn
        return self.key, ", ".join(more + how)


def image(channels: int = 3) -> dict[str, Any]:
    """A bitmap texture of 7 x 6 texels."""
    import mitsuba as mi

    scenes.transforms()
    pixels = 0.4 + 0.2 * np.random.default_rng(1).random((7, 6, channels))
    return {"type": "bitmap", "bitmap": mi.Bitmap(pixels.astype(np.float32)), "raw": True}


def shaped(name: str, **more: Any) -> dict[str, Any]:
    """A thing of the scene with other settings."""
    return {name: {**scenes.scene_dict()[name], **more}}


def ball(kind: str, **more: Any) -> Callable[[], dict[str, Any]]:
    """The ball of another material; a setting given as True is an image."""
    return lambda: shaped("ball", bsdf={"type": kind, **{k: image(1) if v is True else v for k, v in more.items()}})


def relief() -> dict[str, Any]:
    """The ball with a normal map on rough metal."""
    metal = {"type": "roughconductor", "alpha": 0.2}
    return shaped("ball", bsdf={"type": "normalmap", "normalmap": image(), "n": metal})


def instance() -> dict[str, Any]:
    """The box as an instance."""
    T = scenes.transforms()
    box = {k: v for k, v in scenes.scene_dict()["box"].items() if k != "to_world"}
    placed = T().translate([-0.7, 0, 0.4]).scale(0.3)
    nested = {"type": "ref", "id": "group"}
    return {"group": {"type": "shapegroup", "in": box}, "box": {"type": "instance", "to_world": placed, "g": nested}}


def sheet() -> dict[str, Any]:
    """A square of 16 x 16 in place of the box."""
    n, rows = 16, []
    rows += [f"v {i / n - 0.5} {j / n - 0.5} 0" for j in range(n + 1) for i in range(n + 1)]
    for j in range(n):
        for i in range(n):
            a = j * (n + 1) + i + 1
            rows += [f"f {a} {a + 1} {a + n + 1}", f"f {a + 1} {a + n + 2} {a + n + 1}"]
    path = Path(tempfile.mkdtemp()) / "sheet.obj"
    path.write_text("\n".join(rows) + "\n")
    placed = scenes.transforms()().translate([-0.7, 0, 0.4]).scale(0.6)
    return shaped("box", type="obj", filename=str(path), to_world=placed)


def lamp(kind: str) -> Callable[[], dict[str, Any]]:
    """Another lamp: a shape that emits, or a sky."""

    def things() -> dict[str, Any]:
        T = scenes.transforms()
        if kind == "envmap":
            return {"lamp": {"type": "envmap", "bitmap": image()["bitmap"]}}
        placed = T().translate([0.5, -1, 3]).rotate([1, 0, 0], 170).scale(0.4)
        emitter = {"type": "area", "radiance": {"type": "rgb", "value": [5, 6, 7]}}
        return {"lamp": {"type": kind, "to_world": placed, "emitter": emitter}}

    return things


def textured() -> dict[str, Any]:
    """The box with a texture."""
    return shaped("box", bsdf={"type": "diffuse", "reflectance": image()})


EDGES = {"visibility_gradients": True}
EWA = {"filter": "ewa"}
CASES = (
    *(Case(FLOOR, {"filter": name}) for name in rt.filter_names()),
    *(Case(FLOOR, {"filter": name}, pyramid=True) for name in ("bilinear", "ewa", "exact")),
    Case("floor.bsdf.reflectance.to_uv", EWA),
    Case("floor.bsdf.reflectance.to_uv", {"filter": "exact"}),
    Case("box.vertex_texcoords", EWA, textured),
    Case("box.bsdf.reflectance.value"),
    Case("ball.bsdf.alpha.value"),
    Case("ball.bsdf.eta", things=ball("dielectric"), what="dielectric"),
    Case("ball.bsdf.nested_texture.data", EWA, ball("bumpmap", t=True, n={"type": "diffuse"})),
    Case("ball.bsdf.scale", EWA, ball("bumpmap", t=True, n={"type": "diffuse"})),
    Case("ball.bsdf.normalmap.data", EWA, relief),
    Case("ball.bsdf.opacity.value", things=ball("mask", opacity=0.5, n={"type": "diffuse"})),
    Case("lamp.intensity.value"),
    Case("lamp.position"),
    Case("lamp.emitter.radiance.value", things=lamp("rectangle"), what="rectangle"),
    Case("lamp.data", things=lamp("envmap"), what="sky"),
    Case("lamp.data", EWA, lamp("envmap"), what="sky"),
    *(Case("ball.to_world", how) for how in ({}, EWA, EDGES)),
    *(Case("floor.to_world", how) for how in (EWA, {"filter": "exact"}, EDGES)),
    Case("box.to_world", EWA, instance, what="instance"),
    *(Case("sensor.to_world", how) for how in ({}, EWA, {"filter": "exact"}, EDGES)),
    Case("sensor.x_fov", rate=0.01),
    *(Case("box.vertex_positions", how) for how in ({}, EWA, EDGES)),
    Case("box.vertex_positions", {"accel": "kdtree"}),
    Case("box.vertex_positions", {}, sheet, torn=True),
    Case("box.vertex_positions", EDGES, sheet, torn=True),
    *(Case("lamp.to_world", how, lamp("rectangle"), what="rectangle") for how in ({}, EDGES)),
    *(Case("lamp.to_world", how, lamp("sphere"), what="sphere") for how in ({}, EDGES)),
    *(Case("lamp.vertex_positions", how, lamp("cube"), what="light") for how in ({}, EDGES)),
)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--only", nargs="*", default=[], help="cases with any of these words")
    parser.add_argument("--steps", type=int, default=200, help="steps of each case, 100 or more (default 200)")
    parser.add_argument("--long", type=int, default=1000, help="steps where they are quick (default 1000)")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/steps.md"))
    options = parser.parse_args()
    if options.steps < 100:
        parser.error("memory is measured at step 100: --steps must be 100 or more")
    stored = options.out.with_suffix(".json")
    version = f"{code_digest()} {options.steps} {options.long}"
    known = read_json(stored) or {}
    done: dict[str, Any] = known.get("rows", {}) if known.get("version") == version else {}
    cases = [c for c in CASES if not options.only or any(w in " ".join(c.words) for w in options.only)]
    for case in tqdm(cases, unit="case", disable=None):
        name = " ".join(case.words)
        if name not in done:
            done[name] = measured(case, options.steps, options.long)
            save_json(stored, {"version": version, "rows": done})
    rows = [[f"`{case.key}`", case.words[1], *done[" ".join(case.words)]] for case in cases]
    table = markdown_table(HEAD, rows)
    save_text(options.out, f"# Steps of an optimisation: what is compiled and what is kept\n\n{table}")
    print(table)
    return int(any(row[3] for row in rows))


def measured(case: Case, steps: int, long: int) -> list[Any]:
    """The other columns of the table."""
    step = stepper(case)
    compiled = [0, 0]
    arrays: list[int] = []
    memory: list[float] = []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        for number in range(steps):
            dr.kernel_history_clear()
            if number == 2:
                started = time.perf_counter()
            step(number)
            dr.sync_thread()
            compiled[number >= 2] += sum(
                not k["cache_hit"] or k["cache_disk"] for k in dr.kernel_history([dr.KernelType.JIT])
            )
            if number in (9, steps - 1):
                arrays.append(len(dr.whos(as_string=True).splitlines()))
            if number == 99:
                memory.append(megabytes())
    each = (time.perf_counter() - started) / (steps - 2)
    last = steps
    if each < QUICK:
        last = max(steps, long)
        for number in range(steps, last):
            step(number)
        dr.sync_thread()
    memory.append(megabytes())
    return [*compiled, *arrays, *(f"{m:.0f}" for m in memory), last, f"{1000 * each:.1f}"]


def stepper(case: Case) -> Callable[[int], None]:
    """What makes one step, given its number."""
    scene = rt.load_dict(scenes.scene_dict(**case.things()))
    params = rt.traverse(scene)
    latent = scenes.Latent(params, case.key)
    start = {"x": latent.start}
    pyramid = rt.LaplacianPyramid(params[case.key]) if case.pyramid else None
    optimizer = dr.opt.Adam(lr=case.rate, params=start if pyramid is None else pyramid.levels)
    apart = 0.01 * np.random.default_rng(2).normal(size=latent.start.shape) if case.torn else None
    motion = None if apart is None else type(latent.start)(apart.astype(np.float32))
    dr.make_opaque(motion)

    def step(number: int) -> None:
        value = latent.value(optimizer["x"]) if pyramid is None else pyramid.texture(optimizer)
        if motion is not None:
            value = value + motion * dr.opaque(type(motion), number % 100)
        params[case.key] = value
        params.update()
        found = rt.render(scene, params, seed=number, size=(6, 5), **case.how)
        dr.backward(dr.mean(dr.square(found - 0.1), axis=None))
        optimizer.step()

    return step


def megabytes() -> float:
    """What the process has in memory."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


if __name__ == "__main__":
    raise SystemExit(main())
