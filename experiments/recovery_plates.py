"""Plates with normal maps under small lights, for both renderers, and their photographs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import raytrace2 as rt

MATERIALS: dict[str, dict[str, Any]] = {
    "plaster": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.7}},
    "rough metal": {"type": "roughconductor", "alpha": 0.4},
}
#: Where lights stand, one at a time, and cameras, all at once.
LIGHTS = ((-2.5, 0.5, 2.5), (2.0, -1.5, 2.5), (0.5, 2.5, 2.0))
CAMERAS = ((0.0, -3.0, 1.1), (2.6, 1.5, 1.1), (-2.6, 1.5, 1.1))
TEXELS = "plate.bsdf.normalmap.data"
MAX_DEPTH = 2


@dataclass(frozen=True, eq=False)
class Plate:
    """A scene for each light in our form and in Mitsuba's, its photographs by camera, and the true normals."""

    ours: list[rt.Scene]
    mitsuba: list[Any]
    photographs: list[list[np.ndarray]]
    normals: np.ndarray


def make_plate(material: str, size: int, texels: int) -> Plate:
    """The plate of that material with ``texels`` x ``texels`` normals, in images of ``size`` x ``size``."""
    import mitsuba

    mi: Any = mitsuba
    if mi.variant() is None:
        mi.set_variant("llvm_ad_rgb")
    normals = waves(texels)
    flat = np.broadcast_to(np.float32([0, 0, 1]), normals.shape)
    scenes = [[_scene(mi, material, size, n, light) for light in LIGHTS] for n in (normals, flat)]
    photographs = []
    for scene in scenes[0]:
        loaded = mi.load_dict(scene)
        photographs.append([mi.render(loaded, sensor=k, spp=1024, seed=k).numpy() for k in range(len(CAMERAS))])
    return Plate(
        [rt.load_dict(s) for s in scenes[1]], [mi.load_dict(s) for s in scenes[1]], photographs, normals
    )  # fmt: skip


def waves(texels: int) -> np.ndarray:
    """Normals (texels, texels, 3) of waves of many lengths, periodic; slopes deviate by 0.3."""
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(texels), np.fft.fftfreq(texels))) * texels
    noise = np.random.default_rng(7).normal(size=(texels, texels))
    height = np.real(np.fft.ifft2(np.fft.fft2(noise) * np.exp(-((frequency / (texels / 6)) ** 2))))
    slope = np.stack([(np.roll(height, -1, a) - np.roll(height, 1, a)) for a in (1, 0)], axis=-1)
    slope *= 0.3 / slope.std()
    normal = np.concatenate([-slope, np.ones((texels, texels, 1))], axis=-1)
    return (normal / np.linalg.norm(normal, axis=-1, keepdims=True)).astype(np.float32)


def _scene(mi: Any, material: str, size: int, normals: np.ndarray, light: tuple[float, ...]) -> dict[str, Any]:
    T = mi.ScalarTransform4f
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(np.ascontiguousarray(0.5 + 0.5 * normals, np.float32))}
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": MAX_DEPTH},
        "plate": {
            "type": "rectangle",
            "bsdf": {
                "type": "normalmap", "normalmap": {**texture, "raw": True, "wrap_mode": "repeat"},
                "b": MATERIALS[material],
            },
        },
        "lamp": {"type": "point", "position": list(light), "intensity": 12.0},
    }  # fmt: skip
    for k, camera in enumerate(CAMERAS):
        scene[f"camera{k}"] = {
            "type": "perspective", "fov": 42,
            "to_world": T().look_at(origin=list(camera), target=[0, 0, 0], up=[0, 0, 1]),
            "sampler": {"type": "independent", "sample_count": 1},
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
        }  # fmt: skip
    return scene
