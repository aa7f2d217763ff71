"""How far is each texture filter from the truth at one sample a pixel, where does the error come from, and how long
would Mitsuba take to come as near? On a floor at a grazing angle that carries checks, 1/f noise and white noise, for a
box and a Gaussian as the film's pixel filter, and in the mirror ball and through the glass ball of the gallery.

    python experiments/filter_accuracy.py [--samples 4096] [--filters NAME ...] [-o out/filter_accuracy.md]

Writes the tables (Floor, Parts, Speed) and, beside them, a picture of the floor (.png). The truth is the bilinear
texture at so many samples a pixel.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from igehy import CENTRED, supersampled
from igehy import SCENE as GALLERY
from PIL import Image, ImageDraw, ImageFont
from study import markdown_table, save_image, save_text
from tqdm import tqdm

import raytrace2 as rt
from raytrace2.image_io import write_exr
from raytrace2.reference.mitsuba_scene import instantiate, mitsuba_variant, parse
from raytrace2.scene.description import Integrator

FLOOR = Path(__file__).parent.parent / "scenes" / "grazing_floor.xml"
SIZE = 256
TEXELS = 1024

#: Title, filter and differentials.
WAYS = (
    ("bilinear", "bilinear", "none"),
    ("mip by distance", "mip_distance", "distance"),
    ("trilinear, longer axis", "trilinear", "autodiff"),
    ("trilinear, shorter axis", "trilinear_shorter", "autodiff"),
    ("EWA", "ewa", "autodiff"),
    ("EWA, unbounded", "ewa:max_anisotropy=0", "autodiff"),
    ("16 probes", "probes", "autodiff"),
    ("probes, unbounded", "probes:max_anisotropy=0", "autodiff"),
    ("stochastic EWA", "stochastic:of=ewa", "autodiff"),
    ("exact", "exact", "autodiff"),
    ("exact2", "exact2", "autodiff2"),
)
#: Texels that stand for no bound: the whole footprint at the finest level.
UNBOUNDED = 1 << 20
PLACES = ("mirror ball", "glass ball")


@dataclass(frozen=True)
class Case:
    """A floor, its truth, and which pixels lie wholly on it, and which in part."""

    scene: Any
    truth: np.ndarray
    whole: np.ndarray
    part: np.ndarray

    def error(self, image: np.ndarray, mask: np.ndarray | None = None) -> float:
        """Root mean square over the pixels that lie wholly on the floor, or those of ``mask``."""
        difference = np.square(image - self.truth).mean(axis=2)
        return float(np.sqrt(difference[self.whole if mask is None else mask].mean()))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--samples", type=int, default=4096, help="samples a pixel of the truth (default 4096)")
    parser.add_argument("--filters", nargs="*", default=[], help="those whose title contains any of these words")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/filter_accuracy.md"))
    options = parser.parse_args()
    ways = [w for w in WAYS if not options.filters or any(word in w[0] for word in options.filters)]
    made = textures(options.out.parent / "textures")
    cases: dict[str, Case] = {}
    for film in ("box", "gaussian"):
        for name, file in made.items():
            cases[f"{name}, {film}"] = floor(file, film, options.samples)
    images, seconds = {}, {}
    rows = []
    for title, filter, differentials in tqdm(ways, unit="filter", disable=None):
        cells = []
        for key, case in cases.items():
            found, took = rendered(case.scene, filter, differentials, 7 if key == "checks, box" else 1)
            cells.append(f"{case.error(found):.4f}")
            if key == "checks, box":
                images[title], seconds[title] = found, took
        rows.append([title, *cells, f"{1000 * seconds[title]:.1f}"])
    base = cases["checks, box"]
    sections = {
        "Floor": markdown_table(["filter", *cases, "ms"], rows),
        "Parts": parts_table(base, images),
        "Speed": speed_table(ways, base, images, seconds),
    }
    text = "# Accuracy of texture filters\n\n" + "".join(f"## {name}\n\n{body}\n" for name, body in sections.items())
    save_text(options.out, text)
    save_image(options.out.with_suffix(".png"), picture(images, base))
    print(text)
    return 0


def textures(folder: Path) -> dict[str, Path | None]:
    """The files of the floor's textures by name; None for the scene's own."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(1)
    white = rng.random((TEXELS, TEXELS))
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(TEXELS), np.fft.rfftfreq(TEXELS), indexing="ij"))
    frequency[0, 0] = np.inf
    pink = np.fft.irfft2(np.fft.rfft2(white - 0.5) / frequency, s=white.shape)
    pink = np.clip(0.5 + 0.2 * pink / pink.std(), 0, 1)
    found: dict[str, Path | None] = {"checks": None}
    for name, values in (("1/f", pink), ("white", white)):
        file = found[name] = folder / f"{name.replace('/', '')}.exr"
        write_exr(file, np.repeat(values[..., None], 3, axis=2).astype(np.float32), "RGB")
    return found


def floor(file: Path | None, film: str, samples: int) -> Case:
    """The floor with the texture in ``file``, seen through the pixel filter ``film``."""
    given = {"rfilter": film} | ({} if file is None else {"texture": str(file.resolve())})
    scene = rt.load_file(FLOOR, **given)
    # The best filters are so near the truth through a box that its own noise would be seen.
    seeds = 4 if film == "box" else 1
    truth = np.mean([np.array(rt.render(scene, spp=samples, filter="bilinear", seed=k)) for k in range(seeds)], axis=0)
    seen = Integrator(kind="aov", aovs=(("shape", "shape_index"),))
    # Of the pixel and its neighbours, where the pixel filter reaches them.
    found = np.array(rt.render(scene, integrator=seen, spp=1, size=(4 * SIZE, 4 * SIZE)))[..., 0] > 0
    found = found.reshape(SIZE, 4, SIZE, 4)
    whole, some = found.all(axis=(1, 3)), found.any(axis=(1, 3))
    if film != "box":
        whole = np.logical_and.reduce([np.roll(whole, (i, j), (0, 1)) for i in (-2, 0, 2) for j in (-2, 0, 2)])
        whole[:2] = whole[-2:] = whole[:, :2] = whole[:, -2:] = False
    return Case(scene, truth, whole, some & ~whole)


def rendered(scene: Any, filter: str, differentials: str, repeat: int) -> tuple[np.ndarray, float]:
    """The image of one sample a pixel, and the seconds of the quickest of ``repeat`` renders after the first."""

    def render() -> np.ndarray:
        return np.array(rt.render(scene, spp=1, filter=filter, differentials=differentials), np.float64)

    return render(), quickest(render, repeat)


def quickest(task: Callable[[], Any], repeat: int) -> float:
    """Seconds of the quickest run."""
    seconds = []
    for _ in range(repeat):
        begin = time.perf_counter()
        task()
        seconds.append(time.perf_counter() - begin)
    return min(seconds)


def parts_table(case: Case, images: dict[str, np.ndarray]) -> str:
    """The parts of each filter's error: what the affine footprint differs from the pixel by, what the filter's shape
    and its pyramid differ from that by, and pixels that the floor covers in part."""
    affine = _once(case, f"exact:budget={UNBOUNDED}")
    linearisation = case.error(affine)
    rows = []
    for title, image in images.items():
        shape = float(np.sqrt(np.square(image - affine).mean(axis=2)[case.whole].mean()))
        rows.append([title, f"{linearisation:.4f}", f"{shape:.4f}", f"{case.error(image):.4f}",
                     f"{case.error(image, case.part):.4f}"])  # fmt: skip
    pyramid = float(np.sqrt(np.square(_once(case, "exact") - affine).mean(axis=2)[case.whole].mean()))
    head = ["filter", "linearisation", "kernel and pyramid", "in all", "visibility (partly covered pixels)"]
    note = f"Of what `exact` differs by from the affine footprint, all is its pyramid's: {pyramid:.5f}.\n"
    return markdown_table(head, rows) + "\n" + note


def _once(case: Case, filter: str) -> np.ndarray:
    return np.array(rt.render(case.scene, spp=1, filter=filter), np.float64)


def speed_table(
    ways: list[tuple[str, str, str]], floor: Case, images: dict[str, np.ndarray], seconds: dict[str, float]
) -> str:
    """The time that Mitsuba takes to come as near to the truth as each filter, over the filter's own."""
    gallery = rt.load_file(GALLERY, **CENTRED)
    truth, masks = supersampled(gallery, SIZE, 16)
    (on_floor,) = Curve.of(FLOOR, [floor.whole], 1024)
    in_gallery = dict(zip(PLACES, Curve.of(GALLERY, [masks[place] for place in PLACES], 256), strict=True))
    rows = []
    for title, filter, differentials in ways:
        image, took = rendered(gallery, filter, differentials, 5)
        error = np.square(image - truth).mean(axis=2)
        cells = [on_floor.against(floor.error(images[title]), seconds[title])]
        cells += [in_gallery[p].against(float(np.sqrt(error[masks[p]].mean())), took) for p in PLACES]
        rows.append([title, f"{1000 * seconds[title]:.1f}", f"{1000 * took:.1f}", *cells])
    head = ["filter", "floor, ms", "gallery, ms", "floor", *PLACES]
    note = (
        "A cell says how many times longer Mitsuba takes than this filter with one sample a pixel to come as near to "
        "its own truth, with how many samples (multijitter), and at what distance; below 1 Mitsuba is quicker. The "
        "pixels at the balls' inner edges, which no texture filter mends, count.\n"
    )
    return markdown_table(head, rows) + "\n" + note


@dataclass(frozen=True)
class Curve:
    """Mitsuba's distance from its own truth and its seconds by samples a pixel."""

    samples: np.ndarray
    errors: np.ndarray
    seconds: np.ndarray

    @staticmethod
    def of(file: Path, masks: list[np.ndarray], most: int) -> list[Curve]:
        """Measured on ``file`` up to ``most`` samples, over the pixels of each of ``masks``."""
        samples = np.array([n for n in (1, 4, 16, 64, 256, 1024) if n <= most])
        errors: list[list[float]] = [[] for _ in masks]
        seconds = []
        with mitsuba_variant("llvm_ad_rgb") as mi:
            parsed = parse(mi, file, {}, 0, (SIZE, SIZE), 1.0, "multijitter")
            scene = instantiate(mi, parsed, file)

            def render(spp: int, seed: int) -> np.ndarray:
                return np.asarray(mi.render(scene, spp=spp, seed=seed), np.float64)[..., :3]

            truth = np.mean([render(most, 1000 + k) for k in range(12)], axis=0)
            for spp in samples:
                image = render(int(spp), int(spp))
                square = np.square(image - truth).mean(axis=2)
                for found, mask in zip(errors, masks, strict=True):
                    found.append(float(np.sqrt(square[mask].mean())))
                seconds.append(quickest(lambda spp=spp: render(int(spp), 7), 3))
        return [Curve(samples, np.array(found), np.array(seconds)) for found in errors]

    def against(self, error: float, seconds: float) -> str:
        """How much longer Mitsuba takes to reach ``error``, in words."""
        slope = np.polyfit(np.log(self.samples[-3:]), np.log(self.errors[-3:]), 1)[0]
        logs = np.log(self.samples), np.log(self.errors)
        if error >= self.errors[-1]:
            needed = float(np.exp(np.interp(-np.log(error), -logs[1], logs[0])))
        else:
            needed = float(self.samples[-1] * (error / self.errors[-1]) ** (1 / slope))
        time_needed = float(np.exp(np.interp(np.log(needed), logs[0], np.log(self.seconds))))
        time_needed *= max(1.0, needed / self.samples[-1])
        return f"{time_needed / seconds:.1f} ({needed:,.0f} spp for {error:.4f})"


def picture(images: dict[str, np.ndarray], case: Case) -> np.ndarray:
    """The floor by each filter, and the truth."""
    font = ImageFont.load_default(14)
    shown = {**images, "truth": case.truth}
    columns = 4
    rows = -(-len(shown) // columns)
    tall = SIZE // 2
    sheet = Image.new("RGB", (columns * (SIZE + 6), rows * (tall + 28)), "white")
    draw = ImageDraw.Draw(sheet)
    for k, (title, image) in enumerate(shown.items()):
        x, y = (k % columns) * (SIZE + 6), (k // columns) * (tall + 28)
        note = title if title == "truth" else f"{title}: {case.error(image):.4f}"
        draw.text((x + 2, y + 4), note, fill="black", font=font)
        # The far half, where footprints are long.
        top = int(np.argmax(case.whole.any(axis=1)))
        part = np.clip(image[top : top + tall], 0, 1) ** (1 / 2.2)
        sheet.paste(Image.fromarray(np.round(255 * part).astype(np.uint8)), (x, y + 24))
    return np.asarray(sheet)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit("interrupted")
