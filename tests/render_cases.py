"""Small scenes as Mitsuba dicts, and both renderers' images of them."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

import raytrace2 as rt

Dict = dict[str, Any]


def mitsuba() -> Any:
    import mitsuba

    mi: Any = mitsuba
    mi.set_variant("llvm_ad_rgb")
    return mi


def rgb(*value: float) -> Dict:
    return {"type": "rgb", "value": list(value) if len(value) > 1 else value[0]}


def diffuse(*value: float) -> Dict:
    return {"type": "diffuse", "reflectance": rgb(*value)}


def camera(size: tuple[int, int] = (24, 24), kind: str = "perspective", **settings: Any) -> Dict:
    """Looks from (0, 0, 5) at the origin."""
    T = mitsuba().ScalarTransform4f
    look = T().look_at(origin=[0, 0, 5], target=[0, 0, 0], up=[0, 1, 0])
    film = settings.pop("film", {})
    sampler = settings.pop("sampler", {"type": "independent"})
    if kind != "orthographic":
        settings.setdefault("fov", 45)
    scale = T().scale(settings.pop("scale", 1.0))
    film = {"type": "hdrfilm", "width": size[0], "height": size[1], "rfilter": {"type": "box"}, **film}
    return {"type": kind, "to_world": look @ scale, "film": film, "sampler": sampler, **settings}


def scene(*, integrator: Dict | None = None, sensor: Dict | None = None, **things: Any) -> Dict:
    integrator = integrator or {"type": "path", "max_depth": 6}
    return {"type": "scene", "integrator": integrator, "sensor": sensor or camera(), **things}


def corner(**things: Any) -> Dict:
    """A floor and a back wall, both diffuse: something for light to fall on. ``things`` are added."""
    T = mitsuba().ScalarTransform4f
    floor = T().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(3)
    return {
        "floor": {"type": "rectangle", "to_world": floor, "bsdf": diffuse(0.6, 0.5, 0.4)},
        "wall": {"type": "rectangle", "to_world": T().translate([0, 0, -1.5]).scale(3), "bsdf": diffuse(0.3, 0.5, 0.7)},
        **things,
    }  # fmt: skip


def lamp(*value: float, y: float = 1.8, size: float = 0.7) -> Dict:
    """A square that shines downwards."""
    T = mitsuba().ScalarTransform4f
    down = T().translate([0, y, 0]).rotate([1, 0, 0], 90).scale(size)
    return {"type": "rectangle", "to_world": down, "emitter": {"type": "area", "radiance": rgb(*(value or (4,)))}}


def ball(bsdf: Dict | None = None, **settings: Any) -> Dict:
    return {"type": "sphere", "radius": 0.8, "bsdf": bsdf or diffuse(0.5), **settings}


def cornell_box(size: int = 24, **integrator: Any) -> Dict:
    box = mitsuba().cornell_box()
    box["integrator"] = {"type": "path", "max_depth": 8, **integrator}
    box["sensor"]["film"] |= {"width": size, "height": size, "rfilter": {"type": "box"}}
    return box


def ours(source: Dict, spp: int = 16, seed: int = 0, **settings: Any) -> np.ndarray:
    return np.array(rt.render(rt.load_dict(source), spp=spp, seed=seed, **settings))


def theirs(source: Dict, spp: int = 16, seed: int = 0) -> np.ndarray:
    mi = mitsuba()
    return np.array(mi.render(mi.load_dict(source), spp=spp, seed=seed))


def both(source: Dict, spp: int = 16, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Both renderers' images from the same random numbers."""
    return ours(source, spp, seed), theirs(source, spp, seed)


def same_share(a: np.ndarray, b: np.ndarray, tolerance: float = 1e-3) -> float:
    """The share of pixels that agree, relative to themselves (or to a hundredth of the mean, for dark ones)."""
    assert a.shape == b.shape
    floor = 0.01 * float(np.abs(b).mean())
    return float((np.abs(a - b) <= tolerance * np.maximum(np.abs(b), floor)).all(axis=2).mean())


@functools.cache
def texels() -> np.ndarray:
    return np.random.default_rng(5).random((6, 8, 3)).astype(np.float32)
