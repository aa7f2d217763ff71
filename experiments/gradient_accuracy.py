"""How far is the gradient of texels from the truth at one sample a pixel, with each texture filter, on a floor seen at
a grazing angle?

    python experiments/gradient_accuracy.py [--samples 8192] [--filters NAME ...] [-o out/gradient_accuracy.md]

The loss is a sum of the image's pixels, each times a random number of its own (of normal distribution); in the second
column it is the mean square of the image less a grey one, in the third the image's mean. The truth is the gradient of
the bilinear texture at so many samples a pixel; the error is the norm of the difference over the norm of the truth.
Beside the table goes a picture (.png) of the texels' gradients. What is known of the truth is kept in the folder, and a
run that was stopped goes on from there.
"""

from __future__ import annotations

import argparse
import io
import time
from pathlib import Path
from typing import Any

import numpy as np
from study import code_digest, contact_sheet, markdown_table, save_text
from tqdm import tqdm

import raytrace2 as rt  # isort: skip  # before drjit
import drjit as dr  # isort: skip
from raytrace2.files import write_atomically

FLOOR = Path(__file__).parent.parent / "scenes" / "grazing_floor.xml"
TEXELS = "floor.emitter.radiance.data"
#: Title, filter and differentials.
WAYS = (
    ("bilinear", "bilinear", "none"),
    ("mip by distance", "mip_distance", "distance"),
    ("trilinear, longer axis", "trilinear", "autodiff"),
    ("trilinear, shorter axis", "trilinear_shorter", "autodiff"),
    ("EWA", "ewa", "autodiff"),
    ("16 probes", "probes", "autodiff"),
    ("probes, unbounded", "probes:max_anisotropy=0", "autodiff"),
    ("stochastic EWA", "stochastic:of=ewa", "autodiff"),
    ("exact", "exact", "autodiff"),
    ("exact2", "exact2", "autodiff2"),
)
LOSSES = ("random weights", "mean square", "mean")
# Samples a pixel of one render of the truth.
_AT_ONCE = 256


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--samples", type=int, default=8192, help="samples a pixel of the truth (default 8192)")
    parser.add_argument("--filters", nargs="*", default=[], help="those whose title contains any of these words")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/gradient_accuracy.md"))
    options = parser.parse_args()
    ways = [w for w in WAYS if not options.filters or any(word in w[0] for word in options.filters)]
    scene = rt.load_file(FLOOR)
    truth = {loss: true_gradient(scene, loss, options.samples, options.out.parent) for loss in LOSSES}
    rows, pictures = [], {"truth": truth[LOSSES[0]]}
    for title, filter, differentials in tqdm(ways, unit="filter", disable=None):
        cells = []
        for loss in LOSSES:
            found = gradient(scene, loss, filter, differentials, 1, 1)
            started = time.perf_counter()
            gradient(scene, loss, filter, differentials, 1, 2)
            seconds = time.perf_counter() - started
            cells.append(f"{np.linalg.norm(found - truth[loss]) / np.linalg.norm(truth[loss]):.4f}")
            if loss == LOSSES[0]:
                pictures[title] = found
        seen = np.count_nonzero(found) / np.count_nonzero(truth[LOSSES[-1]])
        rows.append([title, *cells, f"{seen:.2f}", f"{1000 * seconds:.0f}"])
    table = markdown_table(["filter", *LOSSES, "texels with a gradient, of those visible", "ms"], rows)
    save_text(options.out, f"# Accuracy of gradients by texels at one sample a pixel\n\n{table}")
    most = np.quantile(np.abs(pictures["truth"]), 0.999)
    contact_sheet(options.out.with_suffix(".png"), [(k, shown(g, most)) for k, g in pictures.items()], 4, 256)
    print(table)
    return 0


def gradient(scene: Any, loss: str, filter: str, differentials: str, samples: int, seed: int) -> np.ndarray:
    """The gradient of the ``loss`` by all texels."""
    params = rt.traverse(scene)
    texels = type(params[TEXELS])(dr.detach(params[TEXELS]))
    dr.disable_grad(texels)
    dr.enable_grad(texels)
    params[TEXELS] = texels
    params.update()
    image = rt.render(scene, params, spp=samples, seed=seed, filter=filter, differentials=differentials)
    pixels = image.array
    if loss == "mean":
        value = dr.mean(pixels)
    elif loss == "mean square":
        value = dr.mean(dr.square(pixels - 0.5))
    else:
        height, width, channels = image.shape
        weights = np.random.default_rng(0).normal(size=(height, width, 1)).repeat(channels, 2)
        value = dr.mean(pixels * type(pixels)(weights.ravel().astype(np.float32)))
    dr.backward(value)
    return np.array(dr.grad(texels))


def true_gradient(scene: Any, loss: str, samples: int, folder: Path) -> np.ndarray:
    """The mean of the gradients of bilinear look-ups, as far as it is not in the ``folder``."""
    file = folder / f"gradient_truth_{loss.replace(' ', '_')}_{code_digest()}.npz"
    total, done = np.zeros(1), 0
    if file.exists():
        with np.load(file) as kept:
            total, done = kept["total"], int(kept["done"])
    for k in tqdm(range(done, -(-samples // _AT_ONCE)), desc=f"truth, {loss}", disable=None):
        total = total + gradient(scene, loss, "bilinear", "none", _AT_ONCE, 1000 + k).astype(np.float64)
        done = k + 1
        stream = io.BytesIO()
        np.savez(stream, total=total, done=done)
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(file, stream.getvalue())
    return total / max(done, 1)


def shown(gradient: np.ndarray, most: float) -> np.ndarray:
    """A corner of the texels' gradient, by the cube root so that small ones are seen; grey is none."""
    grey = 0.5 + 0.5 * np.cbrt(np.clip(gradient[:256, :256, 0] / most, -1, 1))
    return np.repeat((grey * 255).astype(np.uint8)[..., None], 3, axis=2)


if __name__ == "__main__":
    raise SystemExit(main())
