"""What do gradients cost? The time of a backward pass over that of the forward pass, by filter and by what is asked
for, on a floor seen at a grazing angle and in a room with a mirror ball and a glass one.

    python experiments/gradient_cost.py [--samples 16] [--rounds 7] [-o out/gradient_cost.md]

A forward pass makes what filters look up (pyramids, sums) from the texels and renders; the backward pass starts from
the gradient of the image and ends with that of the texels or of what moves. Both are evaluated; the least of several
rounds counts, after two which compile.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from study import markdown_table, save_text
from tqdm import tqdm

import raytrace2 as rt  # isort: skip  # before drjit
import drjit as dr  # isort: skip

SCENES = Path(__file__).parent.parent / "scenes"
FILTERS = (
    ("bilinear", "none"),
    ("trilinear", "autodiff"),
    ("ewa", "autodiff"),
    ("probes", "autodiff"),
    ("exact", "autodiff"),
    ("exact2", "autodiff2"),
)


@dataclass(frozen=True)
class Case:
    """A scene, the parameter that has gradients and how often the backward pass may cost the forward pass."""

    scene: str
    parameter: str
    limit: float

    @property
    def title(self) -> str:
        return f"{self.scene.replace('_', ' ')}: `{self.parameter}`"


CASES = (
    Case("grazing_floor", "floor.emitter.radiance.data", 2.5),
    Case("igehy_room", "floor.bsdf.reflectance.data", 2.5),
    Case("igehy_room", "camera.to_world", 4.0),
    Case("igehy_room", "glass_ball.to_world", 4.0),
)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--samples", type=int, default=16, help="samples a pixel (default 16)")
    parser.add_argument("--rounds", type=int, default=7, help="rounds, of which the best counts (default 7)")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/gradient_cost.md"))
    options = parser.parse_args()
    scenes = {name: rt.load_file(SCENES / f"{name}.xml") for name in {c.scene for c in CASES}}
    rows = []
    for case in tqdm(CASES, unit="case", disable=None):
        cells = []
        for filter, differentials in tqdm(FILTERS, unit="filter", leave=False, disable=None):
            forward, backward = seconds(scenes[case.scene], case, filter, differentials, options)
            cells.append(f"{backward / forward:.2f} ({1000 * forward:.0f} ms)")
        rows.append([case.title, f"{case.limit:g}", *cells])
    head = ["scene and parameter", "at most", *(name for name, _ in FILTERS)]
    said = (
        f"Backward over forward time, and in brackets the forward pass; {options.samples} samples a pixel. With what "
        "moves, footprints have gradients too.\n"
    )
    text = f"# What gradients cost\n\n{said}\n{markdown_table(head, rows)}"
    save_text(options.out, text)
    print(text)
    return 0


def seconds(scene: Any, case: Case, filter: str, differentials: str, options: Any) -> tuple[float, float]:
    """Of the forward and of the backward pass."""
    params = rt.traverse(scene)
    first = type(params[case.parameter])(dr.detach(params[case.parameter]))
    passes = []
    for seed in range(options.rounds + 2):
        value = type(first)(first)
        dr.enable_grad(value)
        params[case.parameter] = value
        params.update()
        dr.sync_thread()
        begin = time.perf_counter()
        image = rt.render(
            scene, params, spp=options.samples, seed=seed, filter=filter, differentials=differentials, progress=False
        )  # fmt: skip
        dr.eval(image)
        dr.sync_thread()
        middle = time.perf_counter()
        dr.backward(dr.mean(dr.square(image.array - 0.5)))
        dr.eval(dr.grad(params[case.parameter]))
        dr.sync_thread()
        passes.append((middle - begin, time.perf_counter() - middle))
    params[case.parameter] = first
    params.update()
    forward, backward = zip(*passes[2:], strict=True)
    return min(forward), min(backward)


if __name__ == "__main__":
    raise SystemExit(main())
