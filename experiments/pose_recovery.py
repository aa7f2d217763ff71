"""Where a camera stands, from one picture: Adam moves it until a render at one sample a pixel looks like the picture,
by filters with and without gradients through footprints, and from coarse to fine. How far off may it begin?

    python experiments/pose_recovery.py [--quick] [--scenes room hall] [--pixels 64] [--directions 16]
        [-o out/pose_recovery.md]

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
from pose_scene import REACH, SCENES, distance, motion, perturbation
from study import code_digest, markdown_table, read_json, save_image, save_json, save_text
from tqdm import tqdm

import raytrace2 as rt
from raytrace2.types import types

import drjit as dr  # isort: skip  (after raytrace2, which chooses its libLLVM)

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
    parser.add_argument("--quick", action="store_true", help="two distances, one direction")
    parser.add_argument("--scenes", nargs="*", default=list(SCENES), choices=list(SCENES), help="default: both")
    parser.add_argument("--pixels", type=int, default=64, help="pixels along a side (default 64)")
    parser.add_argument("--directions", type=int, default=16, help="beginnings at each distance (default 16)")
    parser.add_argument("--steps", type=int, default=20, help="steps at each of the four levels (default 20)")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/pose_recovery.md"))
    options = parser.parse_args()
    studies = []
    for name in tqdm(options.scenes, unit="scene", disable=None):
        sizes, directions = SCENES[name][0], options.directions
        if options.quick:
            sizes, directions = sizes[1:4:2], 1
        search = Search(name, options.pixels, options.steps)
        records = measured(search, sizes, directions, options.out.with_name(f"{options.out.stem}_{name}.json"))
        studies.append(Study(search, sizes, directions, records))
    text = f"# The place of a camera\n\n{said(studies[0])}\n" + "\n".join(s.table() for s in studies)
    save_text(options.out, text)
    save_image(options.out.with_suffix(".png"), stacked([s.picture() for s in studies]))
    print(text)
    return 0


def measured(search: Search, sizes: Sequence[float], directions: int, file: Path) -> dict[str, Record]:
    """A record of each search, by way, size and direction; none from farther away than where one failed."""
    setting = [code_digest(), search.pixels, search.steps]
    kept = read_json(file)
    records: dict[str, Record] = kept["records"] if kept and kept["setting"] == setting else {}
    # Kernels are compiled and functions frozen before clocks run.
    for way in tqdm(WAYS, unit="compilation", leave=False, disable=None):
        search.run(way, 1.0, 0, steps=4)
    for direction in tqdm(range(directions), unit="direction", leave=False, disable=None):
        for way in WAYS:
            for size in sizes:
                key = f"{way.title} {size:g} {direction}"
                if key not in records:
                    records[key] = search.run(way, size, direction, search.steps)
                    save_json(file, {"setting": setting, "records": records})
                # Who does not find back from here does not from farther away.
                if not good(records[key]):
                    break
    return records


class Search:
    """A scene, its picture at every level and the camera's true place."""

    def __init__(self, name: str, pixels: int, steps: int) -> None:
        self.name, self.types, self.pixels, self.steps = name, types("float32"), pixels, steps
        self.scene = SCENES[name][1](pixels)
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


@dataclass(frozen=True, eq=False)
class Study:
    """What was measured of one scene."""

    search: Search
    sizes: Sequence[float]
    directions: int
    records: dict[str, Record]

    def of(self, way: Way, size: float) -> list[Record]:
        keys = [f"{way.title} {size:g} {k}" for k in range(self.directions)]
        return [self.records[key] for key in keys if key in self.records]

    def share(self, way: Way, size: float) -> float:
        """Of the searches that began so far off, the part that found the place."""
        return sum(map(good, self.of(way, size))) / self.directions

    def table(self) -> str:
        rows = []
        for way in WAYS:
            shares = [self.share(way, size) for size in self.sizes]
            runs = [r for size in self.sizes for r in self.of(way, size)]
            errors = [r for r in runs if good(r)]
            near = f"{statistics.median(r['degrees'] for r in errors):.3f}" if errors else ""
            shift = f"{1000 * statistics.median(r['metres'] for r in errors):.1f}" if errors else ""
            kind = way.levels if way.levels != "none" else "no"
            gradients = "" if way.filter == "bilinear" else "yes" if way.footprints else "no"
            seconds = statistics.median(r["seconds"] for r in runs)
            rows.append([kind, way.filter, gradients, *(f"{100 * s:.0f}" for s in shares), f"{self.width(shares):.1f}°",
                         near, shift, f"{seconds:.2f}"])  # fmt: skip
        head = ["levels", "filter", "footprint gradients", *(f"{s:g}°" for s in self.sizes), "width", "error, degrees",
                "error, mm", "s"]  # fmt: skip
        return f"## {self.search.name.capitalize()}\n\n{markdown_table(head, rows)}"

    def width(self, shares: Sequence[float]) -> float:
        """The angle at which half of the searches find the place, between the measured ones along straight lines."""
        before, more = 0.0, 1.0
        for size, now in zip(self.sizes, shares, strict=True):
            if now < 0.5:
                return before + (size - before) * (more - 0.5) / (more - now)
            before, more = size, now
        return self.sizes[-1]

    def picture(self) -> np.ndarray:
        """Shares as colours, and beneath them what a camera sees at each level, by no filter and by EWA."""
        search = self.search
        values = [[self.share(way, size) for size in self.sizes] for way in WAYS]
        chart = heat_chart(f"{search.name}: per cent that found the place, from so far off", [w.title for w in WAYS],
                           [f"{size:g} degrees" for size in self.sizes], {"": values})  # fmt: skip
        search.params["camera.to_world"] = search.pose(search.true)
        search.params.update()
        rows = []
        for filter in ("bilinear", "ewa"):
            seen = []
            for part, _ in LEVELS:
                n = round(search.pixels * part)
                seen.append(np.array(rt.render(search.scene, spp=1, filter=filter, size=(n, n), progress=False)))
            rows.append(np.concatenate([_shown(image) for image in (*seen, search.truth)], axis=1))
        return stacked([chart, np.concatenate(rows)])


def good(record: Record) -> bool:
    return record["degrees"] < FOUND[0] and record["metres"] < FOUND[1]


def said(study: Study) -> str:
    """What the tables show."""
    search = study.search
    return (
        f"{search.pixels} x {search.pixels} pixels, {search.steps * len(LEVELS)} steps of Adam at one sample a pixel, "
        f"{study.directions} directions for each distance: an angle of a turn, and that angle times {REACH:g} m of a "
        f"shift. Per cent that came within {FOUND[0]}° and {1000 * FOUND[1]:g} mm, from there and from all nearer "
        "beginnings in that direction; `width`, where half of them do; median errors of those that did, and median "
        "seconds. Levels: `no`, every step compares whole images; `averaged`, means of 8 x 8, 4 x 4, 2 x 2 pixels and "
        "then whole images; `coarse`, renders of an eighth, a quarter and half the pixels along a side, with "
        "footprints as much wider, and then whole ones.\n"
    )


def stacked(images: Sequence[np.ndarray]) -> np.ndarray:
    """Images (H, W, 3) one below the other, on white."""
    width = max(image.shape[1] for image in images)
    return np.concatenate([np.pad(i, ((0, 0), (0, width - i.shape[1]), (0, 0)), constant_values=255) for i in images])


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
