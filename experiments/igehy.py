"""Igehy's figure ("Tracing Ray Differentials", 1999) once more: one sample a pixel of a gallery, with no texture
filter, by mip maps with distance and with ray differentials, and by the exact integral over the footprint, on the
floor, in the mirror ball and through the glass ball, beside the truth; and how far each is from it.

    python experiments/igehy.py [--size 320] [--supersampling 24] [--filters NAME ...] [-o out/igehy.md]

Writes a table and, beside it, a picture (.png). The truth is the bilinear texture at supersampling^2 places a pixel.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from study import markdown_table, save_image, save_text
from tqdm import tqdm

import raytrace2 as rt
from raytrace2.scene.description import Integrator

SCENE = Path(__file__).parent.parent / "scenes" / "igehy_luminous.xml"

#: One sample in the middle of each pixel, and no choice of its own at the glass ball.
CENTRED = {"sampler": "stratified", "jitter": "false"}

#: Title, filter and differentials of each column of the picture.
FIGURE = (
    ("no filter", "bilinear", "none"),
    ("mip by distance", "mip_distance", "distance"),
    ("mip by differentials", "trilinear", "autodiff"),
    ("exact footprint", "exact", "autodiff"),
)
#: Beside those, in the table.
OTHERS = (
    ("mip, shorter axis", "trilinear_shorter", "autodiff"),
    ("ray cones", "trilinear", "cone"),
    ("EWA", "ewa", "autodiff"),
    ("16 probes", "probes", "autodiff"),
    ("curved footprint", "exact2", "autodiff2"),
)

PLACES = {"floor": ("floor",), "walls": ("left_wall", "right_wall", "far_wall"), "mirror ball": ("mirror_ball",),
          "glass ball": ("glass_ball",), "globe": ("globe",)}  # fmt: skip

#: Left, top, width and height of the details, in parts of the image.
DETAILS = {
    "floor": (0.36, 0.47, 0.2, 0.14),
    "mirror ball": (0.02, 0.46, 0.2, 0.14),
    "glass ball": (0.66, 0.36, 0.2, 0.14),
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--size", type=int, default=320, help="pixels along a side (default 320)")
    parser.add_argument("--supersampling", type=int, default=24, help="places of the truth along a pixel (default 24)")
    parser.add_argument("--filters", nargs="*", default=[], help="those whose title contains any of these words")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/igehy.md"))
    options = parser.parse_args()
    scene = rt.load_file(SCENE, **CENTRED)
    truth, places = supersampled(scene, options.size, options.supersampling)
    images: dict[str, np.ndarray] = {}
    rows = []
    ways = [w for w in (*FIGURE, *OTHERS) if not options.filters or any(word in w[0] for word in options.filters)]
    for title, filter, differentials in tqdm(ways, unit="filter", disable=None):
        image, seconds = rendered(scene, options.size, filter, differentials)
        images[title] = image
        error = np.square(image - truth).mean(axis=2)
        cells = [f"{np.sqrt(error[mask].mean()):.4f}" for mask in places.values()]
        rows.append([title, filter, differentials, *cells, f"{np.sqrt(error.mean()):.4f}", f"{1000 * seconds:.1f}"])
    head = ["", "filter", "differentials", *places, "whole image", "ms"]
    text = (
        f"# Igehy's figure\n\n{options.size} x {options.size} pixels, one sample in the middle of each; root "
        f"mean square distance, in linear light, from the mean of {options.supersampling**2} places a pixel, over the "
        f"pixels that lie wholly on a thing; milliseconds of the render, the best of several.\n\n"
        + markdown_table(head, rows)
    )
    save_text(options.out, text)
    shown = {title: images[title] for title, _, _ in FIGURE if title in images} | {"truth": truth}
    save_image(options.out.with_suffix(".png"), picture(shown, truth))
    print(text)
    return 0


def supersampled(scene: rt.Scene, size: int, places: int) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The mean of ``places`` x ``places`` points of each pixel, and which pixels lie wholly on what."""
    width = size * places
    fine = np.array(rt.render(scene, spp=1, filter="bilinear", size=(width, width)), np.float64)
    truth = fine.reshape(size, places, size, places, 3).mean(axis=(1, 3))
    seen = Integrator(kind="aov", aovs=(("shape", "shape_index"),))
    found = np.array(rt.render(scene, integrator=seen, spp=1, size=(width, width)))[..., 0].astype(int)
    found = found.reshape(size, places, size, places).swapaxes(1, 2).reshape(size, size, -1)
    names = {shape.id: k + 1 for k, shape in enumerate(scene.description.shapes)}
    masks = {place: np.isin(found, [names[i] for i in ids]).all(axis=2) for place, ids in PLACES.items()}
    return truth, masks


def rendered(scene: rt.Scene, size: int, filter: str, differentials: str) -> tuple[np.ndarray, float]:
    """The image of one sample a pixel, and the seconds of the quickest of several renders."""
    seconds = []
    for _ in range(7):
        begin = time.perf_counter()
        image = np.array(rt.render(scene, spp=1, filter=filter, differentials=differentials, size=(size, size)))
        seconds.append(time.perf_counter() - begin)
    return image.astype(np.float64), min(seconds)


def picture(images: dict[str, np.ndarray], truth: np.ndarray) -> np.ndarray:
    """Details side by side, a row a place and a column a filter, each with its distance from the truth."""
    font = _font(15)
    size = len(truth)
    zoom = max(1, round(210 / (size * 0.2)))
    w, h = (round(size * 0.2) * zoom, round(size * 0.14) * zoom)
    left, top, gap = 0, 26, 6
    sheet = Image.new("RGB", (left + len(images) * (w + gap), top + len(DETAILS) * (h + gap)), "white")
    draw = ImageDraw.Draw(sheet)
    for column, (title, image) in enumerate(images.items()):
        x = left + column * (w + gap)
        draw.text((x + 2, 4), title, fill="black", font=font)
        for row, (place, (u, v, du, dv)) in enumerate(DETAILS.items()):
            y = top + row * (h + gap)
            rows = slice(round(v * size), round(v * size) + round(dv * size))
            columns = slice(round(u * size), round(u * size) + round(du * size))
            part = Image.fromarray(_display(image[rows, columns])).resize((w, h), Image.Resampling.NEAREST)
            sheet.paste(part, (x, y))
            distance = np.sqrt(np.square(image[rows, columns] - truth[rows, columns]).mean())
            note = place if title == "truth" else f"{distance:.3f}"
            box = draw.textbbox((x + 6, y + h - 22), note, font=font)
            draw.rectangle((box[0] - 3, box[1] - 2, box[2] + 3, box[3] + 2), fill="white")
            draw.text((x + 6, y + h - 22), note, fill="black", font=font)
    return np.asarray(sheet)


def _display(linear: np.ndarray) -> np.ndarray:
    linear = np.clip(linear, 0, 1)
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
    return np.round(255 * srgb).astype(np.uint8)


def _font(size: int) -> Any:
    return ImageFont.load_default(size)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit("interrupted")
