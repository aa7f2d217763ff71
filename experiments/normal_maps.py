"""Normal maps far away: a grazing floor of bumps under a sky and a sun, as a mirror, rough metal, plaster and glass;
without a filter, with averaged normals, and with the spread of normals made part of the material.

    python experiments/normal_maps.py [--size 192] [--truth 1024] [--filter trilinear] [-o out/normal_maps.md]

Writes a table of errors and, beside it, a picture (.png). The truth is the map itself at many places a pixel. ``bias``
is the error of means over blocks of 8 x 8 pixels, which noise hardly reaches.
"""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from study import contact_sheet, markdown_table, save_text
from tqdm import tqdm

import raytrace2 as rt
from raytrace2.materials import relief_moments

MATERIALS: dict[str, dict[str, Any]] = {
    "mirror": {"type": "conductor"},
    "rough metal": {"type": "roughconductor", "alpha": 0.15},
    "plaster": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.7}},
    "glass": {"type": "dielectric"},
}
WAYS = ("no filter", "normals averaged", "spread of normals")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--size", type=int, default=192, help="width of the images (default 192)")
    parser.add_argument("--truth", type=int, default=1024, help="samples a pixel of the truth (default 1024)")
    parser.add_argument("--samples", type=int, nargs="*", default=[1, 16], help="samples a pixel (default 1 16)")
    parser.add_argument("--filter", default="trilinear", help="the filter of the moments (default trilinear)")
    parser.add_argument("--materials", nargs="*", default=list(MATERIALS))
    parser.add_argument("-o", "--out", type=Path, default=Path("out/normal_maps.md"))
    options = parser.parse_args()
    rows, strips = [], []
    with tqdm(total=len(options.materials) * (1 + len(WAYS) * len(options.samples)), unit="image") as bar:
        for name in options.materials:
            scene = rt.load_dict(floor(MATERIALS[name], options.size))
            truth = image(scene, "no filter", options.truth, options.filter, seed=1)
            bar.update()
            for samples in options.samples:
                shown = [truth]
                for way in WAYS:
                    found = image(scene, way, samples, options.filter)
                    bar.update()
                    shown.append(found)
                    rows.append([name, str(samples), way, f"{rmse(found, truth):.4f}", f"{bias(found, truth):.4f}"])
                caption = f"{name}, {samples} a pixel: truth, " + ", ".join(WAYS)
                strips.append((caption, np.concatenate([displayed(i) for i in shown], axis=1)))
    table = markdown_table(["floor", "samples a pixel", "normals", "RMSE", "bias"], rows)
    save_text(
        options.out, f"# Normal maps far away\n\n{__doc__.partition('Writes')[0].split(chr(10) * 2)[0]}\n\n{table}"
    )
    contact_sheet(options.out.with_suffix(".png"), strips, columns=1, width=4 * options.size)
    print(table)
    return 0


def image(scene: Any, way: str, samples: int, filter: str, seed: int = 0) -> np.ndarray:
    """The floor's image; samples differ between seeds, and a truth shall share none with what it judges."""
    if way == "no filter":
        return np.array(rt.render(scene, spp=samples, seed=seed, filter="bilinear"))
    with means_only() if way == "normals averaged" else contextlib.nullcontext():
        scene._traced.clear()
        return np.array(rt.render(scene, spp=samples, seed=seed, filter=filter))


@contextlib.contextmanager
def means_only() -> Iterator[None]:
    """Maps whose normals do not spread."""
    whole = relief_moments._Moments.at

    def mean(self: Any, place: Any, si: Any, active: Any) -> Any:
        found, covariance, share = whole(self, place, si, active)
        return found, tuple(c * 0 for c in covariance), share

    relief_moments._Moments.at = mean  # type: ignore[method-assign]
    try:
        yield
    finally:
        relief_moments._Moments.at = whole  # type: ignore[method-assign]


def floor(material: dict[str, Any], width: int) -> dict[str, Any]:
    """A scene of a floor that reaches the horizon."""
    import mitsuba

    mi: Any = mitsuba
    if mi.variant() is None:
        mi.set_variant("llvm_ad_rgb")
    T = mi.ScalarTransform4f
    normals = {"type": "bitmap", "bitmap": mi.Bitmap(bumps(256)), "raw": True, "to_uv": T().scale(24)}
    return {
        "type": "scene",
        "integrator": {"type": "direct", "emitter_samples": 16, "bsdf_samples": 16},
        "sensor": {
            "type": "perspective", "fov": 45,
            "to_world": T().look_at(origin=[0.3, -19, 1.5], target=[0.5, 0, -1.5], up=[0, 0, 1]),
            "sampler": {"type": "multijitter", "sample_count": 16},
            "film": {"type": "hdrfilm", "width": width, "height": width * 5 // 8, "rfilter": {"type": "box"}},
        },
        "floor": {
            "type": "rectangle", "to_world": T().scale(20),
            "bsdf": {"type": "normalmap", "normalmap": normals, "b": material},
        },
        "sky": {"type": "envmap", "bitmap": mi.Bitmap(sky(256)), "to_world": T().rotate([1, 0, 0], 90)},
    }  # fmt: skip


def bumps(n: int) -> np.ndarray:
    """A seamless normal map of bumps of many sizes, as colours."""
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(n), np.fft.fftfreq(n))) * n
    spectrum = np.fft.fft2(np.random.default_rng(3).normal(size=(n, n))) * np.exp(-((frequency / 24) ** 2))
    height = np.real(np.fft.ifft2(spectrum))
    du, dv = (np.roll(height, -1, a) - np.roll(height, 1, a) for a in (1, 0))
    slope = np.stack([du, dv], axis=-1)
    slope *= 0.22 / slope.std()
    normal = np.concatenate([-slope, np.ones((n, n, 1))], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return (0.5 + 0.5 * normal).astype(np.float32)


def sky(height: int) -> np.ndarray:
    """A bright horizon, a blue zenith and a broad sun ahead, low in the sky."""
    theta = (np.arange(height) + 0.5) * (np.pi / height)
    phi = (np.arange(2 * height) + 0.5) * (np.pi / height)
    up = np.cos(theta)[:, None, None]
    blue = np.array([0.25, 0.45, 0.9])
    pixels = np.where(up > 0, blue + (1 - blue) * np.exp(-6 * np.abs(up)), 0.15) * np.ones((1, 2 * height, 1))
    away = (np.cos(theta)[:, None] - 0.35) ** 2 + (np.remainder(phi[None, :] - SUN + np.pi, 2 * np.pi) - np.pi) ** 2
    return (pixels + 6 * np.exp(-away / 0.02)[..., None] * np.array([1.0, 0.9, 0.7])).astype(np.float32)


#: The sun's azimuth in the sky's image.
SUN = 0.0


def rmse(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(np.mean((a - b) ** 2)))


def bias(a: np.ndarray, b: np.ndarray) -> float:
    h, w = (n // 8 * 8 for n in a.shape[:2])
    means = [(x[:h, :w].reshape(h // 8, 8, w // 8, 8, 3)).mean(axis=(1, 3)) for x in (a, b)]
    return rmse(means[0], means[1])


def displayed(pixels: np.ndarray) -> np.ndarray:
    linear = np.clip(pixels, 0, 1)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.round(255 * encoded).astype(np.uint8)


if __name__ == "__main__":
    raise SystemExit(main())
