"""Where a camera stands, from one picture: Adam moves it until a render at one sample a pixel looks like the picture,
by filters with and without gradients through footprints, and from coarse to fine. How far off may it begin?

    python experiments/pose_recovery.py [--quick] [--pixels 64] [--directions 8] [-o out/pose_recovery.md]

Writes a table and, beside it, a picture (.png). What was measured is kept beside it too (.json), and not measured again
by the same code.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from charts import heat_chart
from PIL import Image
from pose_scene import REACH, distance, motion, perturbation, room
from study import code_digest, markdown_table, read_json, save_image, save_json, save_text
from tqdm import tqdm

import raytrace2 as rt
from raytrace2.types import types

import drjit as dr  # isort: skip  (after raytrace2, which chooses its libLLVM)

#: Degrees off at the start; and as much times REACH in metres.
SIZES = (2, 4, 8, 12, 16, 24)

#: Parts of the picture's pixels along a side, and Adam's step (radians) there, which falls to a twentieth at the last.
LEVELS = ((1 / 8, 0.012), (1 / 4, 0.012), (1 / 2, 0.008), (1, 0.005))

#: A camera this near, in degrees and metres, has found its place.
FOUND = (0.5, 0.05)


@dataclass(frozen=True)
class Way:
    """``levels``: ``"none"``, all steps compare whole images; ``"averaged"``, blocks of their pixels; ``"coarse"``,
    images are rendered with few pixels, and footprints are as wide."""

    levels: str
    filter: str
    footprints: bool

    @property
    def title(self) -> str:
        gradients = "" if self.filter == "bilinear" else ", with" if self.footprints else ", without"
        return {"none": "fine", "averaged": "averaged", "coarse": "coarse"}[self.levels] + f": {self.filter}{gradients}"


WAYS = (
    *(Way("none", *how) for how in (("bilinear", False), ("ewa", False), ("ewa", True))),
    *(Way("averaged", *how) for how in (("bilinear", False), ("ewa", False), ("ewa", True))),
    Way("coarse", "bilinear", False),
    *(Way("coarse", filter, footprints) for filter in ("trilinear", "ewa", "exact") for footprints in (False, True)),
)

Record = dict[str, float]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--quick", action="store_true", help="two sizes, one direction")
    parser.add_argument("--pixels", type=int, default=64, help="pixels along a side (default 64)")
    parser.add_argument("--directions", type=int, default=8, help="beginnings of each size (default 8)")
    parser.add_argument("--steps", type=int, default=20, help="steps at each of the four levels (default 20)")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/pose_recovery.md"))
    options = parser.parse_args()
    sizes, directions = ((4, 12), 1) if options.quick else (SIZES, options.directions)
    search = Search(options.pixels, options.steps)
    records = measured(search, sizes, directions, options.out.with_suffix(".json"))
    text = report(records, sizes, directions, search)
    save_text(options.out, text)
    save_image(options.out.with_suffix(".png"), picture(records, sizes, directions, search))
    print(text)
    return 0


def measured(search: Search, sizes: Sequence[int], directions: int, file: Path) -> dict[str, Record]:
    """A record of each search, by way, size and direction; none from farther away than where one failed."""
    setting = [code_digest(), search.pixels, search.steps]
    kept = read_json(file)
    records: dict[str, Record] = kept["records"] if kept and kept["setting"] == setting else {}
    # Kernels are compiled and functions frozen before clocks run.
    for way in tqdm(WAYS, unit="compilation", disable=None):
        search.run(way, 1.0, 0, steps=4)
    for direction in tqdm(range(directions), unit="direction", disable=None):
        for way in WAYS:
            for size in sizes:
                key = f"{way.title} {size} {direction}"
                if key not in records:
                    records[key] = search.run(way, size, direction, search.steps)
                    save_json(file, {"setting": setting, "records": records})
                # Who does not find back from here does not from farther away.
                if not good(records[key]):
                    break
    return records


class Search:
    """The room, its picture at every level and the camera's true place."""

    def __init__(self, pixels: int, steps: int) -> None:
        self.types, self.pixels, self.steps = types("float32"), pixels, steps
        self.scene = room(pixels)
        self.params = rt.traverse(self.scene)
        self.true = np.array(self.params["camera.to_world"], np.float64).reshape(4, 4)
        self.truth = np.array(rt.render(self.scene, spp=1024, filter="bilinear", seed=1 << 20, progress=False))
        self.frozen: dict[tuple[Way, float], Any] = {}
        self.targets: dict[float, Any] = {}
        for part, _ in LEVELS:
            n, k = round(pixels * part), round(1 / part)
            means = self.truth.reshape(n, k, n, k, 3).mean(axis=(1, 3))
            self.targets[part] = self.types.TensorXf(np.ascontiguousarray(means))

    def pose(self, matrix: np.ndarray) -> Any:
        value = self.types.Matrix4f(*(self.types.Float(float(e)) for e in matrix.ravel()))
        dr.make_opaque(value)
        return value

    def begin(self, degrees: float, direction: int) -> np.ndarray:
        x = self.types.Float(perturbation(degrees, direction))
        return np.array(motion(x, self.types), np.float64).reshape(4, 4) @ self.true

    def run(self, way: Way, degrees: float, direction: int, steps: int) -> Record:
        """Searches from a camera that is ``degrees`` off."""
        types = self.types
        first = self.begin(degrees, direction)
        begin = self.pose(first)
        opt = dr.opt.Adam(lr=1.0, params={"x": dr.opaque(types.Float, 0, 6)})
        time_begin = time.perf_counter()
        for level, (part, rate) in enumerate(LEVELS):
            target = self.targets[1 if way.levels == "none" else part]
            for k in range(steps):
                fall = 0.05 ** (k / steps) if part == 1 else 1
                opt.set_learning_rate(dr.opaque(types.Float, rate * fall))
                seed = dr.opaque(types.UInt, level * steps + k)
                self.step(way, part)(self.params, opt, begin, target, seed)
        x = opt["x"]
        dr.eval(x)
        dr.sync_thread()
        seconds = time.perf_counter() - time_begin
        found = np.array(motion(x, types), np.float64).reshape(4, 4) @ first
        turn, shift = distance(found, self.true)
        return {"degrees": turn, "metres": shift, "seconds": seconds}

    def step(self, way: Way, part: float) -> Any:
        """One step at a level, as a frozen function."""
        if (way, part) not in self.frozen:
            n = round(self.pixels * part)
            how = {"filter": way.filter, "size": (n, n) if way.levels == "coarse" else (self.pixels, self.pixels)}
            # What the function changes and reads is there before it is frozen.
            self.params["camera.to_world"] = self.pose(self.true)
            self.params.update()
            rt.render(self.scene, self.params, spp=1, **how)
            block = round(1 / part) if way.levels == "averaged" else 1

            def step(params: Any, opt: Any, begin: Any, target: Any, seed: Any) -> None:
                params["camera.to_world"] = motion(opt["x"], self.types) @ begin
                params.update()
                image = rt.render(
                    params.scene, params, spp=1, seed=seed, footprint_gradients=way.footprints, **how
                )  # fmt: skip
                if block > 1:
                    image = dr.reshape(image, (n, block, n, block, 3))
                    image = dr.mean(dr.mean(image, axis=3), axis=1)
                dr.backward(dr.mean(dr.square(image - target), axis=None))
                opt.step()

            self.frozen[way, part] = dr.freeze(step)
        return self.frozen[way, part]


def share(records: dict[str, Record], way: Way, size: int, directions: int) -> float:
    """Of the searches that began so far off, the part that found the place."""
    return sum(map(good, of(records, way, size, directions))) / directions


def of(records: dict[str, Record], way: Way, size: int, directions: int) -> list[Record]:
    keys = [f"{way.title} {size} {k}" for k in range(directions)]
    return [records[key] for key in keys if key in records]


def good(record: Record) -> bool:
    return record["degrees"] < FOUND[0] and record["metres"] < FOUND[1]


def report(records: dict[str, Record], sizes: Sequence[int], directions: int, search: Search) -> str:
    rows = []
    for way in WAYS:
        shares = [share(records, way, size, directions) for size in sizes]
        enough = [s >= 0.5 for s in shares]
        width = sizes[enough.index(False) - 1] if False in enough and enough[0] else sizes[-1] if all(enough) else 0
        runs = [r for size in sizes for r in of(records, way, size, directions)]
        errors = [r for r in runs if good(r)]
        near = f"{statistics.median(r['degrees'] for r in errors):.3f}" if errors else ""
        shift = f"{1000 * statistics.median(r['metres'] for r in errors):.1f}" if errors else ""
        kind = way.levels if way.levels != "none" else "no"
        gradients = "" if way.filter == "bilinear" else "yes" if way.footprints else "no"
        seconds = statistics.median(r["seconds"] for r in runs)
        rows.append([kind, way.filter, gradients, *(f"{100 * s:.0f}" for s in shares), f"{width}°", near, shift,
                     f"{seconds:.2f}"])  # fmt: skip
    head = ["levels", "filter", "footprint gradients", *(f"{s}°" for s in sizes), "width", "error, degrees",
            "error, mm", "s"]  # fmt: skip
    steps = search.steps * len(LEVELS)
    said = (
        f"{search.pixels} x {search.pixels} pixels, {steps} steps of Adam at one sample a pixel, {directions} "
        f"directions for each distance: an angle of a turn, and that angle times {REACH:g} m of a shift. Per cent that "
        f"came within {FOUND[0]}° and {1000 * FOUND[1]:g} mm; `width`, up to which at least half did; median errors of "
        "those that did, and median seconds. Levels: `no`, every step compares whole images; `averaged`, means of "
        "8 x 8, 4 x 4, 2 x 2 pixels and then whole images; `coarse`, renders of an eighth, a quarter and half the "
        "pixels along a side, with footprints as much wider, and then whole ones.\n"
    )
    return f"# The place of a camera\n\n{said}\n" + markdown_table(head, rows)


def picture(records: dict[str, Record], sizes: Sequence[int], directions: int, search: Search) -> np.ndarray:
    """Shares as colours, and beneath them what a camera sees at each level, by no filter and by EWA."""
    values = [[share(records, way, size, directions) for size in sizes] for way in WAYS]
    columns = [f"{size} degrees" for size in sizes]
    chart = heat_chart("per cent that found the place", [w.title for w in WAYS], columns,
                       {"filter, with or without footprint gradients; how far off": values})  # fmt: skip
    search.params["camera.to_world"] = search.pose(search.true)
    search.params.update()
    rows = []
    for filter in ("bilinear", "ewa"):
        seen = []
        for part, _ in LEVELS:
            n = round(search.pixels * part)
            seen.append(np.array(rt.render(search.scene, spp=1, filter=filter, size=(n, n))))
        rows.append(np.concatenate([_shown(image) for image in (*seen, search.truth)], axis=1))
    strip = np.concatenate(rows)
    sheet = np.full((len(chart) + len(strip), max(chart.shape[1], strip.shape[1]), 3), 255, np.uint8)
    sheet[: len(chart), : chart.shape[1]] = chart
    sheet[len(chart) :, : strip.shape[1]] = strip
    return sheet


def _shown(linear: np.ndarray, side: int = 128) -> np.ndarray:
    pixels = np.round(255 * np.clip(linear, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    framed = np.full((side + 4, side + 4, 3), 255, np.uint8)
    framed[2:-2, 2:-2] = np.asarray(Image.fromarray(pixels).resize((side, side), Image.Resampling.NEAREST))
    return framed


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit("interrupted")
