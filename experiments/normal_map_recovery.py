"""Which filter recovers a normal map from photographs in the least time? A plate with unknown normals is seen by three
cameras under three lamps, one at a time. Adam changes slopes, which are zero at first, until renders at one sample a
pixel look like the photographs. Mitsuba's `prb`, with its own bilinear look-ups, does the same beside.

    python experiments/normal_map_recovery.py [--quick] [--size 96] [--texels 96] [--seconds 12]
        [-o out/normal_map_recovery.md]

A step is one lamp, seen by all cameras, also as a frozen function (`dr.freeze`; Mitsuba 3.9.1 crashes in one). Each way
has so many seconds for each of its settings (samples a pixel, learning rate; rates fall to a twentieth), the best of
which counts; compilation and recording do not. Writes a table and, beside it, a picture (.png); a run that was stopped
goes on after the last setting that was done.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from charts import log_charts
from PIL import Image
from recovery_plates import CAMERAS, LIGHTS, MATERIALS, MAX_DEPTH, TEXELS, Plate, make_plate
from study import code_digest, markdown_table, read_json, save_image, save_json, save_text
from tqdm import tqdm

import raytrace2 as rt
from raytrace2.types import types

import drjit as dr  # isort: skip  (after raytrace2, which chooses its libLLVM)

MITSUBA = "Mitsuba prb"
FROZEN = ", frozen"
WAYS = (
    MITSUBA, "bilinear", "trilinear", "ewa", "exact", "bilinear" + FROZEN, "trilinear" + FROZEN, "ewa" + FROZEN,
    "exact" + FROZEN,
)  # fmt: skip
#: (samples a pixel, learning rate of slopes)
MITSUBA_SETTINGS = ((1, 0.03), (1, 0.1), (4, 0.1))
OUR_SETTINGS = ((1, 0.03), (1, 0.1))
TYPES = types("float32")

Record = dict[str, Any]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--quick", action="store_true", help="one material and little time")
    parser.add_argument("--size", type=int, default=96, help="pixels along a side of photographs (default 96)")
    parser.add_argument("--texels", type=int, default=96, help="texels along a side of the map (default 96)")
    parser.add_argument("--seconds", type=float, default=12.0, help="of each setting (default 12)")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/normal_map_recovery.md"))
    options = parser.parse_args()
    seconds = 3.0 if options.quick else options.seconds
    materials = list(MATERIALS)[:1] if options.quick else list(MATERIALS)
    file = options.out.with_suffix(".json")
    setting = [code_digest(), options.size, options.texels, seconds]
    kept = read_json(file)
    records: dict[str, Record] = kept["records"] if kept and kept["setting"] == setting else {}
    work = [(m, w, s) for m in materials for w in WAYS for s in (MITSUBA_SETTINGS if w == MITSUBA else OUR_SETTINGS)]
    plates: dict[str, Plate] = {}
    for material, way, (samples, rate) in tqdm(work, unit="setting", disable=None):
        key = f"{material}, {way}, {samples}, {rate}"
        if key not in records:
            if material not in plates:
                plates[material] = make_plate(material, options.size, options.texels)
            records[key] = recover(plates[material], way, samples, rate, seconds)
            save_json(file, {"setting": setting, "records": records})
    chosen = {m: {w: best(records, m, w) for w in WAYS} for m in materials}
    text = report(chosen, options.size, options.texels, seconds)
    save_text(options.out, text)
    save_image(options.out.with_suffix(".png"), picture(chosen, plates, options.size, options.texels))
    print(text)
    return 0


def recover(plate: Plate, way: str, samples: int, rate: float, seconds: float) -> Record:
    """Steps of Adam for so many seconds: how far normals were off, in mean degrees, with time."""
    size = plate.normals.shape[0]
    slopes = dr.zeros(TYPES.Float, 2 * size * size)
    dr.make_opaque(slopes)
    steps = [_step(plate, way, samples, light) for light in range(len(LIGHTS))]
    # Compiling and recording take a few calls; what they change is forgotten.
    for warm in (True, False):
        opt = dr.opt.Adam(lr=1.0, params={"slopes": slopes})
        curve = [(0.0, off(opt["slopes"], plate))]
        total, count, look = 0.0, 0, 0.0
        while total < seconds and not (warm and count == 3 * len(LIGHTS)):
            dr.sync_thread()
            begin = time.perf_counter()
            opt.set_learning_rate(dr.opaque(TYPES.Float, rate * 0.05 ** (total / seconds)))
            steps[count % len(LIGHTS)](opt, dr.opaque(TYPES.UInt, count) if way.endswith(FROZEN) else count)
            dr.eval(opt["slopes"])
            dr.sync_thread()
            if not warm:
                total += time.perf_counter() - begin
            count += 1
            if not warm and (total > look or total >= seconds):
                curve.append((total, off(opt["slopes"], plate)))
                look = max(1.1 * total, 0.05)
    found = np.round(np.array(normal_map(opt["slopes"], size)), 3)
    return {"curve": curve, "steps": count, "samples": samples, "rate": rate, "map": found.tolist()}


def _step(plate: Plate, way: str, samples: int, light: int) -> Callable[[Any, Any], None]:
    """One step under a lamp, frozen, of the optimiser and a seed."""
    size = plate.normals.shape[0]
    targets = [TYPES.TensorXf(image) for image in plate.photographs[light]]
    filter = way.removesuffix(FROZEN)
    scene: Any
    if way == MITSUBA:
        import mitsuba as mi

        scene, integrator = plate.mitsuba[light], mi.load_dict({"type": "prb", "max_depth": MAX_DEPTH})
        params: Any = mi.traverse(scene)

        def image(scene: Any, params: Any, sensor: int, seed: Any) -> Any:
            return mi.render(scene, params, sensor=sensor, integrator=integrator, spp=samples, seed=seed)
    else:
        scene = plate.ours[light]
        params = rt.traverse(scene)
        params[TEXELS] = normal_map(dr.zeros(TYPES.Float, 2 * size * size), size)
        params.update()
        for sensor in range(len(CAMERAS)):
            rt.render(scene, params, sensor=sensor, spp=samples, filter=filter)

        def image(scene: Any, params: Any, sensor: int, seed: Any) -> Any:
            return rt.render(scene, params, sensor=sensor, spp=samples, seed=seed, filter=filter)

    def step(scene: Any, params: Any, opt: Any, targets: Any, seed: Any) -> None:
        params[TEXELS] = normal_map(opt["slopes"], size)
        params.update()
        loss = 0
        for k, target in enumerate(targets):
            loss = loss + dr.mean(dr.square(image(scene, params, k, seed * len(CAMERAS) + k) - target), axis=None)
        dr.backward(loss)
        opt.step()

    called = dr.freeze(step) if way.endswith(FROZEN) else step
    return lambda opt, seed: called(scene, params, opt, targets, seed)


def normal_map(slopes: Any, size: int) -> Any:
    """The normal map (size, size, 3), as colours, of slopes (2 size^2)."""
    pair = dr.unravel(TYPES.Array2f, slopes)
    scale = dr.rsqrt(1 + dr.squared_norm(pair))
    colours = 0.5 + 0.5 * scale * TYPES.Array3f(-pair.x, -pair.y, 1)
    return TYPES.TensorXf(dr.ravel(colours), (size, size, 3))


def off(slopes: Any, plate: Plate) -> float:
    """Degrees between the normals and the true ones, the mean."""
    found = 2 * np.array(normal_map(slopes, len(plate.normals)), np.float64) - 1
    found /= np.linalg.norm(found, axis=-1, keepdims=True)
    sine = np.linalg.norm(np.cross(found, plate.normals), axis=-1)
    return float(np.degrees(np.arctan2(sine, (found * plate.normals).sum(axis=-1))).mean())


def best(records: dict[str, Record], material: str, way: str) -> Record:
    """Of a way's settings the one that ends nearest."""
    settings = MITSUBA_SETTINGS if way == MITSUBA else OUR_SETTINGS
    return min((records[f"{material}, {way}, {s}, {r}"] for s, r in settings), key=lambda x: x["curve"][-1][1])


def report(chosen: dict[str, dict[str, Record]], size: int, texels: int, seconds: float) -> str:
    rows = []
    for material, ways in chosen.items():
        target = ways[MITSUBA]["curve"][-1][1]
        for way, run in ways.items():
            curve = run["curve"]
            early = [e for t, e in curve if t <= seconds / 10][-1]
            there = next((t for t, e in curve if e <= target), None)
            reached = "never" if there is None else f"{there:.2f}"
            faster = "" if there is None or way == MITSUBA else f"{curve[-1][0] / there:.1f}"
            setting, each = f"{run['samples']}, {run['rate']:g}", f"{1000 * curve[-1][0] / run['steps']:.1f}"
            rows.append([material, way, setting, each, f"{early:.2f}", f"{curve[-1][1]:.2f}", reached, faster])
    head = ["plate", "", "samples, rate", "ms a step", f"degrees after {seconds / 10:g} s", f"after {seconds:g} s",
            "s to Mitsuba's last", "times quicker"]  # fmt: skip
    said = (
        f"{texels} x {texels} normals, {len(CAMERAS)} cameras of {size} x {size} pixels, {len(LIGHTS)} lamps, of which "
        "a step takes one; mean degrees between the normals and the true ones, of the setting of each way that ends "
        "nearest.\n"
    )
    return f"# Normals from photographs\n\n{said}\n" + markdown_table(head, rows)


def picture(chosen: dict[str, dict[str, Record]], plates: dict[str, Plate], size: int, texels: int) -> np.ndarray:
    """Curves, and below them a photograph, the true normals and those that were found, way by way."""
    panels = {m: {w: run["curve"][1:] for w, run in ways.items()} for m, ways in chosen.items()}
    parts = [log_charts("degrees between the normals and the true ones", panels, "seconds of steps")]
    for material, ways in chosen.items():
        plate = plates.get(material) or make_plate(material, size, texels)
        photograph = np.clip(plate.photographs[0][0], 0, 1) ** (1 / 2.2)
        maps = [photograph, 0.5 + 0.5 * plate.normals, *(np.array(run["map"]) for run in ways.values())]
        parts.append(np.concatenate([_shown(m) for m in maps], axis=1))
    width = max(p.shape[1] for p in parts)
    return np.concatenate([np.pad(p, ((0, 4), (0, width - p.shape[1]), (0, 0)), constant_values=255) for p in parts])


def _shown(colours: np.ndarray, side: int = 150) -> np.ndarray:
    image = Image.fromarray(np.round(255 * np.clip(colours, 0, 1)).astype(np.uint8))
    shown = np.asarray(image.resize((side, side), Image.Resampling.NEAREST))
    return np.pad(shown, ((0, 0), (0, 6), (0, 0)), constant_values=255)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit("interrupted")
