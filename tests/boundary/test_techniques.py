"""Edges of shadows as each technique's samples find them, against differences of renders: things that receive light or
give it move."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import raytrace2 as rt
from raytrace2.exr import write_exr

SIZE = 16
VIEW = f"""<sensor type="perspective"><float name="fov" value="45"/><transform name="to_world">
    <lookat origin="0.5,-3,1" target="0,0,-0.2" up="0,0,1"/></transform><film type="hdrfilm"><rfilter type="box"/>
    <integer name="width" value="{SIZE}"/><integer name="height" value="{SIZE}"/></film></sensor>"""
ROUGH = '<bsdf type="roughconductor"><float name="alpha" value="0.3"/></bsdf>'
FLOOR = '<shape type="rectangle" id="floor"><transform name="to_world"><scale value="4"/></transform>{}</shape>'
BALL = """<shape type="sphere" id="ball"><transform name="to_world"><scale value="0.6"/>
    <translate x="0.1" y="0.2" z="0.9"/></transform>{}</shape>"""
CARD = """<shape type="rectangle" id="card"><transform name="to_world"><scale value="0.4"/><rotate x="1" angle="20"/>
    <translate x="-0.1" y="-0.2" z="0.8"/></transform><bsdf type="twosided"><bsdf type="diffuse"/></bsdf></shape>"""
GLOW = '<emitter type="area"><rgb name="radiance" value="5"/></emitter>'
LAMP = f"""<shape type="rectangle" id="lamp"><transform name="to_world"><scale value="0.8"/>
    <lookat origin="0.5,-0.3,3" target="0,0,0" up="0,1,0"/></transform>{GLOW}</shape>"""
BULB = f"""<shape type="sphere" id="lamp"><transform name="to_world"><scale value="0.7"/>
    <translate x="0.8" y="-0.5" z="2.6"/></transform>{GLOW}</shape>"""
WALLS = """<shape type="cube"><boolean name="face_normals" value="true"/><transform name="to_world">
    <scale value="3.1"/><translate z="3.1"/></transform><bsdf type="twosided"><bsdf type="diffuse">
    <rgb name="reflectance" value="0.8"/></bsdf></bsdf></shape>"""
SKY = '<emitter type="constant"/>'
SCENES = {
    "sky": FLOOR.format("") + BALL.format("") + SKY,
    "shiny": FLOOR.format(ROUGH) + BALL.format("") + SKY,
    "lamp": FLOOR.format("") + CARD + LAMP,
    "room": WALLS + CARD.replace("0.4", "0.8") + LAMP,
    "bulb": FLOOR.format("") + CARD + BULB,
}
TURN = np.array([[0, 0, 0.8], [0, 0, -0.6], [-0.8, 0.6, 0]])


def bright_spot(folder: Any) -> str:
    pixels = np.full((8, 16, 3), 0.3, np.float32)
    pixels[1:3, 3:5] = 20
    path = folder / "sky.exr"
    write_exr(path, pixels, ["R", "G", "B"])
    return (
        FLOOR.format("")
        + BALL.format("")
        + f"""<emitter type="envmap"><string name="filename" value="{path}"/>
        <transform name="to_world"><rotate x="1" angle="90"/></transform></emitter>"""
    )


def moved(matrix: np.ndarray, how: str, by: float) -> np.ndarray:
    found = matrix.copy()
    if how == "grow":
        found[:3, :3] *= 1 + by
    elif how == "turn":
        found[:3] += (np.sin(by) * TURN + (1 - np.cos(by)) * TURN @ TURN) @ matrix[:3]
    else:
        found["xyz".index(how), 3] += by
    return found


def compare(scene: rt.Scene, shape: str, how: str, step: float = 0.01, seeds: int = 6) -> tuple[float, float, float]:
    """Differences, derivatives, and the standard deviation of what these differ by."""
    weights = np.random.default_rng(3).random((SIZE, SIZE, 3))
    params = rt.traverse(scene, "float64")
    key = f"{shape}.to_world"
    start = np.array(params[key].numpy(), np.float64).squeeze()

    def total(by: float, seed: int) -> float:
        params[key] = moved(start, how, by)
        params.update()
        return float((np.array(rt.render(scene, params, seed=seed, spp=1024)) * weights).sum())

    def derivative(seed: int) -> float:
        params[key] = start
        dr.enable_grad(params[key])
        dr.set_grad(params[key], type(params[key])((moved(start, how, 1e-6) - moved(start, how, -1e-6)) / 2e-6))
        params.update()
        image = rt.render(scene, params, seed=99, spp=256, seed_grad=seed, visibility_gradients=True)
        dr.forward_to(image)
        return float((np.array(dr.grad(image)) * weights).sum())

    wanted = np.array([(total(step, s) - total(-step, s)) / (2 * step) for s in range(seeds)])
    found = np.array([derivative(1000 + s) for s in range(seeds)])
    spread = np.sqrt((wanted.var(ddof=1) + found.var(ddof=1)) / seeds)
    return float(wanted.mean()), float(found.mean()), float(spread)


@pytest.mark.parametrize(
    "name, integrator, shape, how",
    [
        ("sky", "path", "ball", "grow"),
        ("sky", "direct", "ball", "z"),
        ("shiny", "path", "ball", "grow"),
        ("lamp", "path", "lamp", "grow"),
        ("lamp", "few lights", "floor", "z"),
        ("bulb", "lights", "lamp", "x"),
        ("bulb", "path", "floor", "z"),
        ("spot", "path", "floor", "turn"),
        ("room", "long paths", "card", "grow"),
    ],
)
def test_edges_of_shadows(name: str, integrator: str, shape: str, how: str, tmp_path: Any) -> None:
    kinds = {
        "path": '<integrator type="path"><integer name="max_depth" value="2"/></integrator>',
        "long paths": '<integrator type="path"><integer name="max_depth" value="4"/></integrator>',
        "direct": '<integrator type="direct"/>',
        "lights": '<integrator type="direct"><integer name="bsdf_samples" value="0"/></integrator>',
        "few lights": """<integrator type="direct"><integer name="emitter_samples" value="1"/>
            <integer name="bsdf_samples" value="2"/></integrator>""",
    }
    parts = bright_spot(tmp_path) if name == "spot" else SCENES[name]
    scene = rt.load_string(f'<scene version="3.0.0">{kinds[integrator]}{VIEW}{parts}</scene>')
    wanted, found, spread = compare(scene, shape, how)
    assert abs(found - wanted) < 4 * spread
    assert spread < 0.06 * abs(wanted)
