"""How right are the footprints of each way to carry ray differentials, and what does each cost?

    python experiments/differentials.py [--scene scenes/igehy_room.xml] [--size 256] [--rounds 9] [--filter trilinear]
                                        [--out out]

Rays go through the middle of every pixel to the first surface that is neither mirror nor glass. There the footprint in
float32 is compared with central differences of float64 rays 1e-6 of the film apart, where those meet the same
primitives; the error is that of both vectors, relative to both, in pixels without a flag. `distance` and `cone` know no
directions: for them it is that of the ellipse, |sqrt(J J') - sqrt(T T')| / |sqrt(T T')|. After a diffuse bounce there
is no truth of this kind: the float64 result of `autodiff` stands for it, so that its column tells
of how that bounce's rule is met.

Writes differentials.md and differentials.png: for a grid of pixels what each way takes a pixel's disk for, seen back in
the image. A way without error draws circles; flagged footprints are red.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw
from study import contact_sheet, markdown_table, save_text
from tqdm import tqdm

import raytrace2 as rt
from raytrace2.rays.camera import make_camera
from raytrace2.rays.differentials import DIFFERENTIALS, make_differentials
from raytrace2.rays.differentials.trust import FOLDED, SEAM, SILHOUETTE, TOTAL_REFLECTION
from raytrace2.rays.ray import Ray
from raytrace2.reference.report import srgb_bytes
from raytrace2.render import choose_camera

import drjit as dr  # isort: skip  (after raytrace2, which chooses its libLLVM)

WAYS = tuple(name for name in DIFFERENTIALS if name != "none")
PLACES = ("floor", "mirror ball", "glass ball", "globe", "after a diffuse bounce")
NEAR = 1e-6
STOPS = 6
CELL, SHOWN, ZOOM = 16, 9.0, 3


@dataclass
class Ends:
    """The first surface on each ray's way that is neither mirror nor glass, and the next one: uv (n, 2), footprints
    (n, 2, 2; columns are dx and dy), flags (n,), whether there is one (n,), and the surfaces met on the way (n,)."""

    uv: np.ndarray
    footprint: np.ndarray
    flags: np.ndarray
    valid: np.ndarray
    way: np.ndarray
    after: np.ndarray
    after_valid: np.ndarray


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--scene", type=Path, default=Path(__file__).parent.parent / "scenes/igehy_room.xml")
    parser.add_argument("--size", type=int, default=256, help="pixels along each side")
    parser.add_argument("--rounds", type=int, default=9, help="renders of each way that are timed, in turns")
    parser.add_argument("--filter", default="trilinear", help="the filter that reads the footprints while timed")
    parser.add_argument("--out", type=Path, default=Path("out"))
    options = parser.parse_args()
    scene = rt.load_file(options.scene)
    size = options.size
    truth, same = central_differences(scene, size)
    exact = follow(scene, "autodiff", size, "float64")
    found = {name: follow(scene, name, size, "float32") for name in tqdm(WAYS, unit="way", disable=None)}
    regions = places(scene, exact, same)
    text = "# Ray differentials\n\n" + accuracy(found, truth, exact, regions) + flags_table(found, regions)
    text += cost(scene, size, options.rounds, options.filter)
    print(text)
    save_text(options.out / "differentials.md", text)
    picture(options.out / "differentials.png", scene, size, found, truth, same)
    return 0


def film_positions(size: int) -> tuple[np.ndarray, np.ndarray]:
    middle = (np.arange(size) + 0.5) / size
    x, y = np.meshgrid(middle, middle)
    return x.ravel(), y.ravel()


def follow(scene: rt.Scene, name: str, size: int, precision: str, shift: tuple[float, float] = (0, 0)) -> Ends:
    """Rays through the middle of every pixel, moved by ``shift`` of the film."""
    traced = scene.traced(precision=precision)
    traced.prepare_shading()
    t = traced.types
    camera = make_camera(choose_camera(scene, 0, (size, size)), t)
    step = t.Float(1 / size)
    dr.make_opaque(step)
    way = make_differentials(name, (step, step), 1.0)
    x, y = film_positions(size)
    ray, state = way.start(camera, t.Array2f(x + shift[0], y + shift[1]), None)
    ray = Ray.of(ray.o, ray.d, ray.tmin, ray.tmax)
    dr.eval(ray, state)
    n = x.size
    active, first = dr.full(t.Bool, True, n), np.ones(n, bool)
    ends = Ends(np.zeros((n, 2)), np.zeros((n, 2, 2)), np.zeros(n, np.uint32), np.zeros(n, bool), np.zeros(n),
                np.zeros((n, 2, 2)), np.zeros(n, bool))  # fmt: skip
    second = np.zeros(n, bool)
    for _ in range(STOPS):
        meeting = way.meet(traced.structure, ray, state, traced.structure.intersect(ray, active))
        si, material = meeting.si, traced.material(meeting.si, active & meeting.si.valid)
        sample = traced.materials.sample(meeting.scatter, material, t.Float(0.9999), t.Array2f(0.3, 0.7), si.valid)
        onward = meeting.scatter.spawn_ray(meeting.scatter.to_world(sample.wo))
        after = way.leave(meeting, sample, onward, state)
        onward = dr.detach(onward)
        footprint = [] if si.footprint is None else [si.footprint.dx, si.footprint.dy, si.footprint.flags]
        smooth = traced.materials.has_smooth(material, si.valid)
        active = active & si.valid
        dr.eval(si, footprint, smooth, onward, after, active)
        valid, stops = full(active, n), full(smooth, n)
        code = full(si.surface, n).astype(float) + 1
        ends.way = np.where(first & valid, ends.way * 64 + code, ends.way)
        J = np.zeros((n, 2, 2))
        if footprint:
            J = np.stack([full_columns(v, n) for v in footprint[:2]], axis=2)
        here = first & valid & stops
        ends.uv[here] = full_columns(si.uv, n)[here]
        ends.footprint[here] = J[here]
        if footprint:
            ends.flags[here] = full(footprint[2], n)[here]
        ends.valid |= here
        next_one = second & valid
        ends.after[next_one], ends.after_valid[next_one] = J[next_one], True
        second, first = here, first & valid & ~stops
        ray, state = Ray.of(onward.o, onward.d, onward.tmin, onward.tmax), after
    return ends


def full(v: Any, n: int) -> np.ndarray:
    return np.broadcast_to(v.numpy(), n)


def full_columns(v: Any, n: int) -> np.ndarray:
    return np.stack([full(c, n).astype(float) for c in v], axis=1)


def central_differences(scene: rt.Scene, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Footprints (n, 2, 2), and where the rays on all sides met the same."""
    sides = [follow(scene, "none", size, "float64", s) for s in ((NEAR, 0), (-NEAR, 0), (0, NEAR), (0, -NEAR))]
    same = sides[0].valid.copy()
    for side in sides[1:]:
        same &= side.valid & (side.way == sides[0].way)
    columns = [(a.uv - b.uv) / (2 * NEAR * size) for a, b in (sides[:2], sides[2:])]
    same &= (np.abs(columns[0]).max(axis=1) < 1e3) & (np.abs(columns[1]).max(axis=1) < 1e3)
    return np.stack(columns, axis=2), same


def places(scene: rt.Scene, ends: Ends, same: np.ndarray) -> dict[str, np.ndarray]:
    names = [shape.id for shape in scene.description.shapes]

    def code(*ids: str) -> float:
        return float(sum((names.index(id) + 1) * 64**k for k, id in enumerate(reversed(ids))))

    begins_glass = np.floor(ends.way / 64) == code("glass_ball", "glass_ball")
    begins_mirror = np.floor(ends.way / 64) == code("mirror_ball")
    floor = ends.way == code("floor")
    return dict(zip(PLACES, (
        floor & same, begins_mirror & same, begins_glass & same, (ends.way == code("globe")) & same,
        floor & ends.after_valid,
    ), strict=True))  # fmt: skip


def ellipse(J: np.ndarray) -> np.ndarray:
    """The symmetric roots (n, 2, 2) of J J'."""
    square = J @ J.transpose(0, 2, 1)
    root = np.abs(np.linalg.det(J))[:, None, None]
    trace = np.trace(square, axis1=1, axis2=2)[:, None, None]
    return (square + root * np.eye(2)) / np.sqrt(np.maximum(trace + 2 * root, 1e-300))


def off(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.linalg.norm(a - b, axis=(1, 2)) / np.maximum(np.linalg.norm(b, axis=(1, 2)), 1e-30)


def accuracy(found: dict[str, Ends], truth: np.ndarray, exact: Ends, regions: dict[str, np.ndarray]) -> str:
    rows = []
    for name, ends in found.items():
        row = [f"`{name}`"]
        shape = ellipse if name in ("distance", "cone") else np.asarray
        for place, lanes in regions.items():
            if place == PLACES[-1]:
                lanes = lanes & ends.after_valid
                errors = off(shape(ends.after[lanes]), shape(exact.after[lanes]))
            else:
                lanes = lanes & ends.valid & (ends.way == exact.way) & (ends.flags == 0)
                errors = off(shape(ends.footprint[lanes]), shape(truth[lanes]))
            row.append(f"{np.median(errors):.1e}, {np.quantile(errors, 0.99):.1e}" if errors.size else "none")
        rows.append(row)
    return "## Error of the footprint: median, 99 %\n\n" + markdown_table(["", *PLACES], rows) + "\n"


def flags_table(found: dict[str, Ends], regions: dict[str, np.ndarray]) -> str:
    names = {"folded": FOLDED, "total reflection": TOTAL_REFLECTION, "silhouette": SILHOUETTE, "seam or pole": SEAM}
    rows = []
    for name in ("finite", "autodiff"):
        for place in PLACES[:-1]:
            flags = found[name].flags[regions[place]]
            rows.append([f"`{name}`, {place}", *(f"{100 * np.mean(flags & bit != 0):.2f}" for bit in names.values())])
    return "## Flags: per cent of pixels\n\n" + markdown_table(["", *names], rows) + "\n"


def cost(scene: rt.Scene, size: int, rounds: int, filter: str) -> str:
    """Times and operation counts of the path tracer at 16 samples a pixel, in turns."""
    ways: Sequence[str] = ("none", *WAYS)
    seconds: dict[str, list[float]] = {name: [] for name in ways}
    operations: dict[tuple[str, bool], int] = {}
    for turn in tqdm(range(-1, rounds), unit="round", disable=None):
        for name in ways:
            for filtered in (True, False):
                if not filtered and turn >= 0:
                    continue
                kind = None if not filtered else "bilinear" if name == "none" else filter
                with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
                    dr.kernel_history_clear()
                    begin = time.perf_counter()
                    shape = size, size
                    dr.eval(rt.render(scene, differentials=name, filter=kind, size=shape, spp=16, progress=False))
                    dr.sync_thread()
                    spent = time.perf_counter() - begin
                    kernels = dr.kernel_history([dr.KernelType.JIT])
                if turn >= 0 and filtered:
                    seconds[name].append(spent)
                operations[name, filtered] = max(k["operation_count"] for k in kernels)
    rows = []
    for name in ways:
        against = [np.median(np.array(seconds[name]) / np.array(seconds[other])) for other in ("none", "analytic")]
        rows.append([f"`{name}`", *(f"{a:.2f}" for a in against), str(operations[name, True]),
                     str(operations[name, False])])  # fmt: skip
    head = ["", "time over `none`", "time over `analytic`", "operations", "operations without a filter"]
    said = (
        f"`none` looks up by `bilinear`, the others by `{filter}`; a ratio is the median of those of {rounds} turns.\n"
    )
    return "## Cost on the demo room\n\n" + markdown_table(head, rows) + "\n" + said


def picture(
    path: Path, scene: rt.Scene, size: int, found: dict[str, Ends], truth: np.ndarray, same: np.ndarray
) -> None:  # fmt: skip
    shown = size * ZOOM
    image = rt.render(scene, spp=16, size=(shown, shown), progress=False)
    backdrop = srgb_bytes(np.array(image)) // 2 + 96
    angle = np.linspace(0, 2 * np.pi, 25)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    strips = []
    for name, ends in found.items():
        canvas = Image.fromarray(backdrop.astype(np.uint8))
        draw = ImageDraw.Draw(canvas)
        for row in range(CELL // 2, size, CELL):
            for column in range(CELL // 2, size, CELL):
                i = row * size + column
                if not (same[i] and ends.valid[i]) or abs(np.linalg.det(truth[i])) < 1e-14:
                    continue
                seen = np.linalg.solve(truth[i], ends.footprint[i]) @ circle * SHOWN
                seen = np.clip(seen, -1.4 * CELL * ZOOM, 1.4 * CELL * ZOOM)
                middle = (np.array([column, row]) + 0.5) * ZOOM
                color = (220, 30, 30) if ends.flags[i] else (0, 40, 160)
                draw.line([tuple(p) for p in (seen.T + middle)], fill=color, width=2)
        strips.append((name, np.asarray(canvas)))
    contact_sheet(path, strips, columns=2, width=shown)


if __name__ == "__main__":
    sys.exit(main())
