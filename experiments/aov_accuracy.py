"""Do our aovs equal Mitsuba's at the same sample positions, and where not, which of the two is nearer to the truth?

    python experiments/aov_accuracy.py FOLDER [--scale 0.25] [--only WORD ...] [--out out/aov_accuracy]

Samples all over the image, at the same places for both renderers. "Difference" is ours - Mitsuba's, each with its own
camera, both in float32. "Error" is the distance from the truth along the same ray: our float64 trace of Mitsuba's
float32 camera ray. "Whole error" is that from float64 all the way, camera included. Depth, dp_du, dp_dv, duv_dx and
duv_dy are relative to themselves, position to the larger of itself and the depth, uv to max(1, |uv|); normals and
albedo are absolute. They are asked where both renderers met the same primitive; where they did not is counted, and
settled by the truth as well. (Mitsuba's rectangles are two triangles each; here both count as one primitive.)

Writes aov_accuracy.md and aov_accuracy.png (ours, Mitsuba's, and the difference from 1e-8, black, to 1e-3, white).
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from study import contact_sheet, markdown_table, save_text, scene_files
from tqdm import tqdm

import raytrace2 as rt
from raytrace2.integrators.aov import aov, channel_names
from raytrace2.rays.camera import make_camera
from raytrace2.reference.mitsuba_scene import mitsuba_variant
from raytrace2.reference.report import srgb_bytes
from raytrace2.scene.description import Integrator, MeshShape

KINDS = ("depth", "position", "uv", "geo_normal", "sh_normal", "dp_du", "dp_dv", "duv_dx", "duv_dy", "albedo")
INDICES = ("prim_index", "shape_index")
SETTINGS = Integrator("aov", aovs=tuple((kind, kind) for kind in (*KINDS, *INDICES)))
Values = dict[str, np.ndarray]


@dataclass
class Case:
    """One scene: values of every kind, (n, channels) float64; ``cos``, between each ray and the normal it met;
    ``height``, the least height of the triangle that it met over the largest coordinate there (inf on other shapes).

    ``ours`` and ``theirs`` are each renderer's own, ``exact`` is in float64; ``ours_same`` and ``truth`` follow
    Mitsuba's camera rays."""

    name: str
    size: tuple[int, int]
    ours: Values
    theirs: Values
    exact: Values
    ours_same: Values
    truth: Values
    cos: np.ndarray
    height: np.ndarray

    def hit(self, values: Values) -> np.ndarray:
        return values["depth"][:, 0] > 0

    def same(self, *others: Values) -> np.ndarray:
        """Lanes where all of ``others`` met the same primitive."""
        first, *rest = others
        result = self.hit(first)
        for other in rest:
            result &= self.hit(other)
            for kind in INDICES:
                result &= (other[kind] == first[kind])[:, 0]
        return result


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("path", type=Path, help="a folder of Mitsuba scenes, or one scene")
    parser.add_argument("--scale", type=float, default=0.25, help="rays per pixel along each axis")
    parser.add_argument("--only", nargs="*", default=[], help="scenes whose name contains any of these words")
    parser.add_argument("--out", type=Path, default=Path("out/aov_accuracy"))
    options = parser.parse_args()
    cases: list[Case] = []
    for file in tqdm(scene_files(options.path, options.only), unit="scene", disable=None):
        try:
            scene = rt.load_file(file, spp=1)
        except rt.RayTraceError:
            tqdm.write(f"{file.stem:34s} refused")
            continue
        cases.append(trace(file, scene, options.scale))
        tqdm.write("  ".join(f"{cell:>9s}" if k else f"{cell:34s}" for k, cell in enumerate(scene_row(cases[-1]))))
    text = report(cases)
    print(text)
    save_text(options.out / "aov_accuracy.md", text)
    contact_sheet(options.out / "aov_accuracy.png", [(case.name, strip(case)) for case in cases], columns=1, width=1080)
    medians = [np.median(d) for case in cases for kind in KINDS if len(d := differences(case, kind)[1])]
    return int(max(medians, default=0.0) > 1e-6)


def trace(file: Path, scene: rt.Scene, scale: float) -> Case:
    camera = scene.description.cameras[0]
    film = camera.film
    width, height = (max(1, round(n * scale)) for n in (film.crop_width, film.crop_height))
    rng = np.random.default_rng(0)
    y, x = np.divmod(np.arange(width * height), width)
    place = np.stack([(x + rng.random(x.size)) / width, (y + rng.random(x.size)) / height]).astype(np.float32)
    lens = rng.random((2, x.size)).astype(np.float32)
    theirs, mitsuba_rays = mitsuba(file, place, lens)
    own, same = {}, {}
    for precision in ("float32", "float64"):
        traced = scene.traced(precision=precision)
        traced.prepare_shading()
        t = traced.types
        mine = make_camera(camera, t)
        steps = (t.Array2f(0), t.Array2f(1 / film.crop_width, 0), t.Array2f(0, 1 / film.crop_height))
        ray, *offsets = (mine.sample_ray(t.Array2f(place) + step, t.Array2f(lens)) for step in steps)
        own[precision] = values_of(aov(traced, SETTINGS, ray, tuple(offsets)))
        o, d, tmax = mitsuba_rays[0]
        ray = rt.Ray(o, d, 0.0, tmax, precision=precision)
        offsets = [rt.Ray(*r, precision=precision) for r in mitsuba_rays[1:]]
        same[precision] = values_of(aov(traced, SETTINGS, ray, tuple(offsets)))
    truth, d = same["float64"], mitsuba_rays[0][1]
    cos = np.abs((d * truth["geo_normal"]).sum(axis=1)) / np.linalg.norm(d, axis=1)
    rename_shapes(theirs, own["float32"])
    for number, shape in enumerate(scene.description.shapes, 1):
        if not isinstance(shape, MeshShape):
            theirs["prim_index"][theirs["shape_index"] == number] = 0
    return Case(file.stem, (width, height), own["float32"], theirs, own["float64"], same["float32"], truth, cos,
                heights(scene, truth))  # fmt: skip


def heights(scene: rt.Scene, values: Values) -> np.ndarray:
    height = np.full(len(values["depth"]), np.inf)
    for number, shape in enumerate(scene.description.shapes, 1):
        lanes = np.flatnonzero(values["shape_index"][:, 0] == number)
        if isinstance(shape, MeshShape) and lanes.size:
            corners = shape.vertices[shape.faces[values["prim_index"][lanes, 0].astype(int)]]
            edges = corners - np.roll(corners, 1, axis=1)
            double_area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
            least = double_area / np.maximum(np.linalg.norm(edges, axis=2).max(axis=1), 1e-300)
            height[lanes] = least / np.abs(corners).max(axis=(1, 2))
    return height


def mitsuba(file: Path, place: np.ndarray, lens: np.ndarray) -> tuple[Values, list[Any]]:
    """Mitsuba's values, and its camera's ray with those a pixel to the right and down: origins, directions (n, 3)."""
    with mitsuba_variant("llvm_ad_rgb") as mi:
        # Merged meshes would number their faces through.
        scene = mi.load_file(str(file), optimize=False, spp=1)
        spec = ",".join(f"{name}:{kind}" for name, kind in SETTINGS.aovs)
        integrator = mi.load_dict({"type": "aov", "aovs": spec})
        ray, _ = scene.sensors()[0].sample_ray_differential(0.0, 0.5, mi.Point2f(place), mi.Point2f(lens))
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(0, place.shape[1])
        channels = integrator.sample(scene, sampler, ray)[2]
        own = [(ray.o, ray.d), (ray.o_x, ray.d_x), (ray.o_y, ray.d_y)]
        width = place.shape[1]
        rays: list[Any] = [tuple(spread(np.array(v).T, width) for v in pair) for pair in own]
        rays[0] = (*rays[0], np.broadcast_to(np.array(ray.maxt), width).copy())
        return values_of(channels), rays


def spread(values: np.ndarray, width: int) -> np.ndarray:
    return np.ascontiguousarray(np.broadcast_to(values, (width, 3)))


def values_of(channels: list[Any]) -> Values:
    import drjit as dr  # after raytrace2, which chooses its libLLVM

    dr.eval(channels)
    columns = [np.array(c, dtype=np.float64) for c in channels]
    width = max(c.size for c in columns)
    found: Values = {}
    for name, column in zip(channel_names(SETTINGS), columns, strict=True):
        kind = name.partition(".")[0]
        column = np.broadcast_to(column, width)[:, None].copy()
        found[kind] = np.concatenate([found[kind], column], axis=1) if kind in found else column
    return found


def rename_shapes(theirs: Values, ours: Values) -> None:
    """Mitsuba numbers shapes as they were made: each of its numbers becomes that of ours which it mostly meets."""
    numbers, own = theirs["shape_index"], ours["shape_index"]
    renamed = np.zeros_like(numbers)
    for number in np.unique(numbers[numbers > 0]):
        found, counts = np.unique(own[numbers == number], return_counts=True)
        renamed[numbers == number] = found[counts.argmax()]
    theirs["shape_index"] = renamed


def apart(kind: str, a: Values, b: Values) -> np.ndarray:
    """The distance of ``a`` from ``b`` in the units of this study."""
    distance = np.linalg.norm(a[kind] - b[kind], axis=1)
    size = np.linalg.norm(b[kind], axis=1)
    if kind in ("geo_normal", "sh_normal", "albedo"):
        return distance
    if kind == "uv":
        return distance / np.maximum(1, size)
    if kind == "position":
        size = np.maximum(size, b["depth"][:, 0])
    return np.where(distance == 0, 0, distance / np.where(size > 0, size, 1e-300))


def differences(case: Case, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Lanes where both met the same primitive, and how far apart they are there."""
    lanes = np.flatnonzero(case.same(case.ours, case.theirs))
    return lanes, apart(kind, case.ours, case.theirs)[lanes]


def errors(cases: list[Case], kind: str) -> list[np.ndarray]:
    """Errors of ours and of Mitsuba's along the same rays, and whole errors of both, over all scenes."""
    found: list[list[np.ndarray]] = [[], [], [], []]
    for case in cases:
        for k, (ours, truth) in enumerate(((case.ours_same, case.truth), (case.ours, case.exact))):
            lanes = case.same(ours, case.theirs, truth)
            found[2 * k].append(apart(kind, ours, truth)[lanes])
            found[2 * k + 1].append(apart(kind, case.theirs, truth)[lanes])
    return [np.concatenate(values) for values in found]


def scene_row(case: Case) -> list[str]:
    a, b = case.hit(case.ours), case.hit(case.theirs)
    both = a & b
    other = both & ~case.same(case.ours, case.theirs)
    cells = [case.name, str(a.size), str(int((a != b).sum())), str(int(other.sum()))]
    return cells + [f"{np.median(d):.1e}" if len(d := differences(case, k)[1]) else "" for k in KINDS]


def report(cases: list[Case]) -> str:
    text = "# Our aovs and Mitsuba's\n\n" + (__doc__ or "").partition("\n\n")[2].partition("\n\n")[2] + "\n"
    head = ["scene", "rays", "hit by one only", "other primitive", *KINDS]
    text += "## Median difference\n\n" + markdown_table(head, [scene_row(c) for c in cases]) + "\n"
    rows = []
    for kind in KINDS:
        columns = [np.concatenate([differences(c, kind)[1] for c in cases]), *errors(cases, kind)]
        spans = [(np.median(v), np.quantile(v, 0.999), v.max()) for v in columns]
        rows.append([kind, *(" / ".join(f"{q:.1e}" for q in span) for span in spans)])
    head = ["kind", "difference", "our error", "Mitsuba's error", "our whole error", "Mitsuba's whole error"]
    text += "## All scenes: median / 99.9 % / worst\n\n" + markdown_table(head, rows) + "\n"
    text += "## Rays that met different things\n\n" + strangers(cases) + "\n"
    head = ["kind", "scene", "pixel", "difference", "our error", "Mitsuba's error", "cos", "cause"]
    return text + "## The worst\n\n" + markdown_table(head, [worst(cases, kind) for kind in KINDS])


def strangers(cases: list[Case]) -> str:
    """Who is right where the two met different things along the same ray."""
    rays = ours_right = theirs_right = neither = 0
    for case in cases:
        ours, theirs = (hit_like(v, case.truth) for v in (case.ours_same, case.theirs))
        differ = ~hit_like(case.ours_same, case.theirs)
        rays += differ.size
        ours_right += int((differ & ours & ~theirs).sum())
        theirs_right += int((differ & theirs & ~ours).sum())
        neither += int((differ & ~ours & ~theirs).sum())
    total = ours_right + theirs_right + neither
    return (
        f"Along the same {rays} rays the two meet different primitives, or one meets nothing, on {total}. "
        f"float64 agrees with ours on {ours_right}, with Mitsuba's on {theirs_right}, with neither on {neither}.\n"
    )


def hit_like(a: Values, b: Values) -> np.ndarray:
    same = (a["depth"] > 0) == (b["depth"] > 0)
    for kind in INDICES:
        same &= a[kind] == b[kind]
    return same[:, 0]


def worst(cases: list[Case], kind: str) -> list[str]:
    """The ray with the greatest difference of all scenes, and why."""
    found = [(case, *differences(case, kind)) for case in cases]
    case, lanes, d = max(found, key=lambda f: f[2].max(initial=0))
    lane = int(lanes[d.argmax()])
    ours, theirs = (float(apart(kind, v, case.truth)[lane]) for v in (case.ours_same, case.theirs))
    y, x = divmod(lane, case.size[0])
    return [kind, case.name, f"{x}, {y}", f"{d.max():.1e}", f"{ours:.1e}", f"{theirs:.1e}", f"{case.cos[lane]:.2g}",
            cause(case, lane, kind, ours, theirs)]  # fmt: skip


def cause(case: Case, lane: int, kind: str, ours: float, theirs: float) -> str:
    truth = case.truth
    if kind == "uv" and np.abs(case.ours["uv"] - case.theirs["uv"])[lane].max() > 0.5:
        return "seam: uv jumps from 1 to 0, the point lies within rounding of it"
    if kind.startswith("duv"):
        own, other = (float(apart(kind, v, case.exact)[lane]) for v in (case.ours, case.theirs))
        if other > 10 * own:
            return (
                f"whole errors {own:.0e}, {other:.0e}: Mitsuba's perspective camera starts offset rays where the "
                "central ray meets the near plane, which is near_clip / depth off"
            )
    if not case.same(case.ours_same, case.theirs, truth)[lane]:
        return "the edge of a primitive: float64 meets its neighbour"
    where = []
    like = truth["shape_index"][:, 0] == truth["shape_index"][lane, 0]
    sizes = [np.linalg.norm(truth[k], axis=1) for k in ("dp_du", "dp_dv")]
    thin = min(size[lane] / np.median(size[like]) for size in sizes)
    if np.isinf(case.height[lane]) and thin < 0.1:
        where.append(f"pole: dp_du or dp_dv is {thin:.1g} of what it mostly is")
    if case.height[lane] < 0.02:
        where.append(f"a triangle {case.height[lane]:.0e} of its coordinates high, in which rounding grows by as much")
    if case.cos[lane] < 0.05:
        where.append(f"grazing: rounding of the ray moves the point by 1 / cos = {1 / case.cos[lane]:.0f} as much")
    if kind == "albedo":
        where.append(f"uv differs by {apart('uv', case.ours, case.theirs)[lane]:.0e}, and the texture is steep")
    if theirs > 4 * ours:
        where.append("rounding in Mitsuba")
    elif ours > 4 * theirs:
        where.append("rounding in ours")
    else:
        where.append("rounding in both")
    return "; ".join(where)


def strip(case: Case) -> np.ndarray:
    """Depth, shading normal and uv: ours, Mitsuba's, and the logarithm of the difference."""
    tiles = []
    for kind in ("depth", "sh_normal", "uv"):
        for values in (case.ours, case.theirs):
            tiles.append(srgb_bytes(shown(kind, values[kind]).reshape(case.size[1], case.size[0], 3)))
        d = np.where(case.hit(case.ours) | case.hit(case.theirs), apart(kind, case.ours, case.theirs), 0)
        grey = np.clip((np.log10(np.maximum(d, 1e-8)) + 8) / 5, 0, 1)
        tiles.append(np.repeat(np.uint8(255 * grey).reshape(case.size[1], case.size[0], 1), 3, axis=2))
    return np.concatenate(tiles, axis=1)


def shown(kind: str, values: np.ndarray) -> np.ndarray:
    if kind == "depth":
        hit = values[:, 0] > 0
        least, most = (np.quantile(values[hit, 0], q) for q in (0.01, 0.99)) if hit.any() else (0.0, 1.0)
        grey = np.where(hit, 1 - 0.9 * np.clip((values[:, 0] - least) / max(most - least, 1e-9), 0, 1), 0)
        return np.repeat(grey[:, None], 3, axis=1).astype(np.float32)
    if kind == "uv":
        return np.concatenate([values - np.floor(values), np.zeros((len(values), 1))], axis=1).astype(np.float32)
    return (0.5 * values + 0.5).astype(np.float32)


if __name__ == "__main__":
    sys.exit(main())
