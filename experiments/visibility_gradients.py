"""Derivatives of an image in which things move: inside surfaces only, with moving edges, and differences of renders.

    python experiments/visibility_gradients.py

A cube, a ball and a disk over a floor move to the right: in the light of a small lamp, under a sky, most of which
sampled materials find, and in a bright room where light is scattered up to three times. Writes
out/visibility_gradients.png (for each the image, then its derivative by that motion: differences of renders, with and
without moving edges; red grows, blue shrinks) and out/visibility_gradients.md.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import raytrace2 as rt  # isort: skip  (before drjit: it settles libLLVM)
import drjit as dr
import numpy as np
from study import contact_sheet, markdown_table, save_text
from tqdm import tqdm

OUT = Path("out")
SPP, DIFFERENCE_SPP, STEP = 64, 1024, 0.01
SCENE = """<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>
<sensor type="perspective"><float name="fov" value="40"/>
  <transform name="to_world"><lookat origin="0.5,-5,3.2" target="0,0,0.3" up="0,0,1"/></transform>
  <film type="hdrfilm"><integer name="width" value="240"/><integer name="height" value="160"/>
    <rfilter type="box"/></film>
</sensor>
{around}
<shape type="cube" id="cube"><boolean name="face_normals" value="true"/><transform name="to_world">
  <scale value="0.4"/><rotate z="1" angle="30"/><translate x="-1" z="0.45"/></transform>
  <bsdf type="diffuse"><rgb name="reflectance" value="0.8,0.3,0.2"/></bsdf></shape>
<shape type="sphere" id="ball"><transform name="to_world"><scale value="0.5"/>
  <translate x="0.3" y="0.3" z="0.8"/></transform>
  <bsdf type="diffuse"><rgb name="reflectance" value="0.2,0.5,0.8"/></bsdf></shape>
<shape type="disk" id="disk"><transform name="to_world"><scale value="0.4"/><rotate x="1" angle="60"/>
  <translate x="1.3" y="-0.3" z="0.7"/></transform>
  <bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0.4,0.7,0.3"/></bsdf></bsdf></shape>
</scene>"""
FLOOR = '<shape type="rectangle"><transform name="to_world"><scale value="4"/></transform></shape>'
LAMP = """<shape type="rectangle"><transform name="to_world"><scale value="{}"/>
  <lookat origin="-2,-1.5,4" target="0,0,0" up="0,1,0"/></transform>
  <emitter type="area"><rgb name="radiance" value="{}"/></emitter></shape>"""
SKY = '<emitter type="constant"><rgb name="radiance" value="2"/></emitter>'
WALLS = """<shape type="cube"><boolean name="face_normals" value="true"/><transform name="to_world">
  <scale x="4" y="5.5" z="2.5"/><translate z="2.5"/></transform><bsdf type="twosided"><bsdf type="diffuse">
  <rgb name="reflectance" value="0.8"/></bsdf></bsdf></shape>"""
#: How deep paths go, and what is around the things that move.
PLACES = {
    "a small lamp": (2, FLOOR + LAMP.format(0.35, 60)),
    "a sky": (2, FLOOR + SKY),
    "a room": (4, WALLS + LAMP.format(0.8, 8)),
}


def starts(params: Any) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """What moves: values, and how they change per unit of motion to the right."""
    found = {}
    for key in ("cube.vertex_positions", "ball.to_world", "disk.to_world"):
        value = np.array(params[key].numpy(), np.float64).squeeze()
        motion = np.zeros_like(value)
        if value.ndim == 1:
            motion[0::3] = 1
        else:
            motion[0, 3] = 1
        found[key] = value, motion
    return found


def derivative(scene: rt.Scene, edges: bool) -> tuple[np.ndarray, float]:
    """The derivative of the image in forward mode, and the seconds that it took (the second time)."""
    seconds = 0.0
    for _ in range(2):
        params = rt.traverse(scene)
        for key, (value, motion) in starts(params).items():
            params[key] = value
            dr.enable_grad(params[key])
            dr.set_grad(params[key], type(params[key])(motion.astype(np.float32)))
        params.update()
        begin = time.perf_counter()
        image = rt.render(scene, params, spp=SPP, visibility_gradients=edges)
        dr.forward_to(image)
        found = np.array(dr.grad(image))
        seconds = time.perf_counter() - begin
    return found, seconds


def differences(scene: rt.Scene) -> np.ndarray:
    """Central differences with the same samples on both sides."""
    params = rt.traverse(scene)
    before = starts(params)
    total: Any = 0.0
    for sign in (1, -1):
        params.update({key: value + sign * STEP * motion for key, (value, motion) in before.items()})
        parts = [rt.render(scene, seed=s, spp=DIFFERENCE_SPP // 4) for s in tqdm(range(4), desc="differences")]
        total = total + sign * np.mean([np.array(p, np.float64) for p in parts], axis=0) / (2 * STEP)
    params.update({key: value for key, (value, _) in before.items()})
    return np.asarray(total)


def signed(x: np.ndarray) -> np.ndarray:
    """White for nothing, red for more, blue for less."""
    y = np.clip(x.mean(axis=2) / 1.5, -1, 1)[..., None]
    color = np.where(y > 0, 1 - y * [0, 1, 1], 1 + y * [1, 1, 0])
    return (color * 255).astype(np.uint8)


def blocks(x: np.ndarray) -> np.ndarray:
    return x.mean(axis=2).reshape(20, 8, 30, 8).mean(axis=(1, 3))


def error(x: np.ndarray, truth: np.ndarray) -> str:
    rest = np.linalg.norm(blocks(x) - blocks(truth)) / np.linalg.norm(blocks(truth))
    return f"{100 * rest:.1f} %"


def main() -> None:
    rows, strips = [], []
    for place, (depth, around) in PLACES.items():
        scene = rt.load_string(SCENE.format(depth=depth, around=around))
        image = np.array(rt.render(scene, spp=256))
        truth = differences(scene)
        with_edges, slow = derivative(scene, True)
        without, fast = derivative(scene, False)
        strips += [
            (f"{place}: the image", (np.clip(image, 0, 1) ** (1 / 2.2) * 255).astype(np.uint8)),
            (f"differences of renders, {DIFFERENCE_SPP} samples a pixel", signed(truth)),
            (f"with visibility_gradients, {SPP} samples a pixel", signed(with_edges)),
            ("without", signed(without)),
        ]
        rows += [
            [place, "with", error(with_edges, truth), f"{with_edges.sum():.1f}", f"{slow / fast:.2f}"],
            [place, "without", error(without, truth), f"{without.sum():.1f}", "1"],
            [place, "differences", "", f"{truth.sum():.1f}", ""],
        ]
    contact_sheet(OUT / "visibility_gradients.png", strips)
    head = [
        "light of",
        "moving edges",
        "error of the derivative in blocks of 8 x 8 pixels",
        "its sum over the image",
        "time",
    ]
    text = f"# A cube, a ball and a disk move to the right\n\n{markdown_table(head, rows)}\n"
    text += (
        f"Forward mode, {SPP} samples a pixel and as many points of edges for silhouettes, for the shadows of each "
        "group of curves and for what surfaces gather light from (half as many for each time that light was scattered "
        "before); in the room light is scattered up to three times. Errors relative to central differences of renders, "
        "whose own noise is part of them.\n"
    )
    save_text(OUT / "visibility_gradients.md", text)
    print(text)


if __name__ == "__main__":
    main()
