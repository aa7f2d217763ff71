"""Where cameras look for their place: a room papered with dead leaves, in which every piece of wall looks unlike every
other at every scale, and the hall of the filters' figure, whose tiles are all alike and which is also seen in a mirror
ball and through one of glass; and the camera as a function of six numbers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

import raytrace2 as rt
from raytrace2.types import Types

import drjit as dr  # isort: skip  (after raytrace2, which chooses its libLLVM)

#: Metres of a shift that weigh as much as a turn by one radian.
REACH = 3.0

#: Where the room's camera truly stands, and what it looks at.
ORIGIN, TARGET = (0.4, 0.0, 1.6), (-0.3, 7.0, 1.3)

#: Half the width, half the depth and half the height of the room; its middle lies at (0, HALF[1] - 6, HALF[2]).
HALF = (3.5, 8.0, 1.6)


def room(size: int, texels: int = 512) -> rt.Scene:
    """The room, which shines by itself, seen in ``size`` x ``size`` pixels."""
    import mitsuba

    mi: Any = mitsuba
    if mi.variant() is None:
        mi.set_variant("llvm_ad_rgb")
    T = mi.ScalarTransform4f
    w, d, h = HALF
    middle = T().translate([0, d - 6, h])
    sides = {
        "floor": T().translate([0, 0, -h]).scale([w, d, 1]),
        "ceiling": T().translate([0, 0, h]).rotate([1, 0, 0], 180).scale([w, d, 1]),
        "far": T().translate([0, d, 0]).rotate([1, 0, 0], 90).scale([w, h, 1]),
        "left": T().translate([-w, 0, 0]).rotate([0, 0, 1], 90).rotate([1, 0, 0], 90).scale([d, h, 1]),
        "right": T().translate([w, 0, 0]).rotate([0, 0, 1], -90).rotate([1, 0, 0], 90).scale([d, h, 1]),
    }
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 1},
        "camera": {
            "type": "perspective", "fov": 50,
            "to_world": T().look_at(origin=list(ORIGIN), target=list(TARGET), up=[0, 0, 1]),
            "sampler": {"type": "stratified", "sample_count": 1},
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
        },
    }  # fmt: skip
    for k, (name, place) in enumerate(sides.items()):
        paper = {"type": "bitmap", "bitmap": mi.Bitmap(leaves(texels, k)), "raw": True, "wrap_mode": "mirror"}
        scene[name] = {
            "type": "rectangle", "to_world": middle @ place, "emitter": {"type": "area", "radiance": paper},
            "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse"}},
        }  # fmt: skip
    return rt.load_dict(scene)


def hall(size: int) -> rt.Scene:
    """The hall, which shines by itself, seen in ``size`` x ``size`` pixels."""
    file = Path(__file__).parent.parent / "scenes" / "igehy_luminous.xml"
    return rt.load_file(file, width=size, height=size, spp=1, sampler="stratified")


#: How far off searches begin, in degrees (and as much times REACH in metres), and what makes the scene.
SCENES: dict[str, tuple[tuple[float, ...], Callable[[int], rt.Scene]]] = {
    "room": ((2, 4, 8, 12, 16, 24), room),
    "hall": ((0.5, 1, 2, 4, 8), hall),
}


def leaves(texels: int, seed: int, count: int = 4000) -> np.ndarray:
    """(texels, texels, 3) linear float32: disks of all sizes upon each other (dead leaves: the radii's density falls
    with the third power), drawn at twice the size."""
    rng = np.random.default_rng(seed)
    n = 2 * texels
    small, large = 2.0, n / 5
    radii = (small**-2 + rng.random(count) * (large**-2 - small**-2)) ** -0.5
    radii[: count // 8] = np.exp(rng.uniform(np.log(n / 50), np.log(large), count // 8))
    colours = rng.integers(10, 256, (count, 3))
    image = Image.new("RGB", (n, n), (128, 128, 128))
    draw = ImageDraw.Draw(image)
    for (x, y), r, c in zip(rng.uniform(0, n, (count, 2)), radii, colours, strict=True):
        draw.ellipse((x - r, y - r, x + r, y + r), fill=tuple(int(v) for v in c))
    encoded = np.asarray(image, np.float64).reshape(texels, 2, texels, 2, 3) / 255
    return (encoded**2.2).mean(axis=(1, 3)).astype(np.float32)


def motion(x: Any, types: Types) -> Any:
    """The rigid motion of six numbers ``x`` (Float, width 6): a turn about the direction of the first three by their
    length, then a shift by REACH times the others."""
    F = types.Float
    a, b, c, *shift = (dr.gather(F, x, i) for i in range(6))
    angle = dr.sqrt(a * a + b * b + c * c + 1e-12)
    s, half = dr.sin(angle) / angle, dr.sin(0.5 * angle) / (0.5 * angle)
    v = 0.5 * half * half
    rows = (
        (1 - v * (b * b + c * c), v * a * b - s * c, v * a * c + s * b, REACH * shift[0]),
        (v * a * b + s * c, 1 - v * (a * a + c * c), v * b * c - s * a, REACH * shift[1]),
        (v * a * c - s * b, v * b * c + s * a, 1 - v * (a * a + b * b), REACH * shift[2]),
        (0, 0, 0, 1),
    )
    return types.Matrix4f(*(F(e) for row in rows for e in row))


def perturbation(degrees: float, direction: int) -> np.ndarray:
    """Six numbers: a turn by ``degrees`` and a shift by REACH times that angle, both in directions that ``direction``
    counts."""
    turn, shift = np.random.default_rng(direction).normal(size=(2, 3))
    angle = np.radians(degrees)
    return angle * np.concatenate([turn / np.linalg.norm(turn), shift / np.linalg.norm(shift)])


def distance(found: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """Degrees and metres between two poses."""
    turn = found[:3, :3] @ true[:3, :3].T
    angle = np.degrees(np.arctan2(np.linalg.norm(turn - turn.T) / np.sqrt(2), np.trace(turn) - 1))
    return float(angle), float(np.linalg.norm(found[:3, 3] - true[:3, 3]))
