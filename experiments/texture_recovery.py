"""Which filter recovers a texture from photographs in the least time? The floor of the room, which is seen directly, in
the mirror ball and through the glass ball, from three places, is grey at first; steps of Adam on the mean square of
render less photograph bring its texels near the truth. Mitsuba's `prb`, with its own bilinear look-ups, does the same
beside, in the same process; and what is optimised is the texels, or the levels of a Laplacian pyramid of them.

    python experiments/texture_recovery.py [--size 256] [--texels 256] [--seconds 60] [--ours 15] [--only WORD ...]
        [-o out/texture_recovery]

Each way is tried with several learning rates and samples a pixel, of which the best counts: for Mitsuba the one with
the least error after its seconds, for a filter the one that first comes as near. Learning rates fall to a tenth over a
run. Seconds are those of steps, without the first four, which compile and are recorded. Writes a table (.md) and a
picture (.png); a run that was stopped goes on after the last setting that was done.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from charts import log_charts
from PIL import Image
from recovery_scene import MAX_DEPTH, PLACES, TEXELS, Room, make_room
from study import code_digest, contact_sheet, markdown_table, read_json, save_json, save_text
from tqdm import tqdm

import raytrace2 as rt  # isort: skip  # before drjit
import drjit as dr  # isort: skip
import drjit.opt  # isort: skip
from raytrace2.buffers import owned  # isort: skip

LEVELS, FROZEN = ", levels", ", frozen"
#: Title, filter and differentials; None for Mitsuba. With ``LEVELS``, what is optimised is a Laplacian pyramid; with
#: ``FROZEN``, a step is a frozen function, in which Mitsuba 3.9.1 crashes.
WAYS: tuple[tuple[str, tuple[str, str] | None], ...] = (
    ("Mitsuba prb", None),
    ("Mitsuba prb" + LEVELS, None),
    ("bilinear", ("bilinear", "none")),
    ("bilinear" + FROZEN, ("bilinear", "none")),
    ("trilinear", ("trilinear", "autodiff")),
    ("EWA", ("ewa", "autodiff")),
    ("EWA" + LEVELS, ("ewa", "autodiff")),
    ("EWA" + FROZEN, ("ewa", "autodiff")),
    ("16 probes", ("probes", "autodiff")),
    ("16 probes" + FROZEN, ("probes", "autodiff")),
    ("exact", ("exact", "autodiff")),
    ("exact" + LEVELS, ("exact", "autodiff")),
    ("exact" + FROZEN, ("exact", "autodiff")),
)
#: Those in the picture.
SHOWN = ("Mitsuba prb", "bilinear", "trilinear", "EWA, frozen", "16 probes, frozen", "exact, frozen")
#: (samples a pixel, learning rate)
MITSUBA_SETTINGS = ((4, 0.02), (16, 0.03))
OUR_SETTINGS = ((1, 0.03), (1, 0.08))
_WARM_UP = 4
_GREY = 0.5


@dataclass(frozen=True)
class Run:
    """A way with one setting: how the root mean square error of texels fell with seconds, and the last texels."""

    title: str
    samples: int
    rate: float
    curve: list[tuple[float, float]]
    steps: int
    compile_seconds: float
    texels: np.ndarray

    def reaches(self, error: float) -> float | None:
        """The first second with an error of at most ``error``."""
        return next((t for t, e in self.curve if e <= error), None)

    def error_at(self, seconds: float) -> float:
        """The error after so many seconds."""
        return [e for t, e in self.curve if t <= seconds][-1]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--size", type=int, default=256, help="pixels along a side of each photograph (default 256)")
    parser.add_argument("--texels", type=int, default=256, help="texels along a side of a tile (default 256)")
    parser.add_argument("--seconds", type=float, default=60.0, help="of each of Mitsuba's settings (default 60)")
    parser.add_argument("--ours", type=float, default=15.0, help="of each of ours (default 15)")
    parser.add_argument("--only", nargs="*", default=[], help="ways whose title contains any of these words")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/texture_recovery"))
    options = parser.parse_args()
    room = make_room(options.out, options.size, options.texels)
    digest = code_digest() + room.digest
    runs: dict[str, list[Run]] = {}
    work = [(title, way, s) for title, way in WAYS for s in (OUR_SETTINGS if way else MITSUBA_SETTINGS)]
    work = [w for w in work if not options.only or any(word in w[0] for word in options.only)]
    for title, way, (samples, rate) in tqdm(work, unit="setting", disable=None):
        seconds = options.ours if way else options.seconds
        file = options.out / f"{title.replace(', ', '_').replace(' ', '_')}_{samples}_{rate}_{seconds:g}.json"
        known = read_json(file)
        if known is None or known["digest"] != digest:
            make = our_renderer(room, way) if way else mitsuba_renderer(room)
            run = recover(title, make, room, samples, rate, seconds)
            np.save(file.with_suffix(".npy"), run.texels)
            save_json(file, {**vars(run), "texels": None, "digest": digest})
        else:
            kept = {k: v for k, v in known.items() if k != "digest"}
            run = Run(**{**kept, "texels": np.load(file.with_suffix(".npy"))})
        runs.setdefault(title, []).append(run)
    text = report(runs, options.seconds)
    print(text)
    save_text(options.out.with_suffix(".md"), text)
    picture(options.out.with_suffix(".png"), runs, room)
    return 0


@dataclass(frozen=True)
class Renderer:
    """Parameters with the texels, their type, and the image of camera ``k`` with so many samples and a seed."""

    params: Any
    tensor: Any
    image: Callable[[int, int, int], Any]


def our_renderer(room: Room, way: tuple[str, str]) -> Renderer:
    params = rt.traverse(room.ours)
    params.keep([TEXELS])
    # What changes for the first time gets tables of its own, which no frozen function can make.
    params[TEXELS] = held(np.full_like(room.texels, _GREY), params.types.TensorXf)
    params.update()
    how: dict[str, Any] = {"filter": way[0], "differentials": way[1]}
    return Renderer(
        params,
        params.types.TensorXf,
        lambda k, spp, seed: rt.render(room.ours, params, sensor=k, spp=spp, seed=seed, **how),
    )


def mitsuba_renderer(room: Room) -> Renderer:
    import mitsuba as mi

    params = mi.traverse(room.mitsuba)
    params.keep([TEXELS])
    integrator = mi.load_dict({"type": "prb", "max_depth": MAX_DEPTH})

    def image(k: int, spp: int, seed: int) -> Any:
        return mi.render(room.mitsuba, params, sensor=k, spp=spp, seed=seed, integrator=integrator)

    return Renderer(params, mi.TensorXf, image)


def recover(title: str, renderer: Renderer, room: Room, samples: int, rate: float, seconds: float) -> Run:
    """Steps of Adam from grey for so many seconds."""
    tensor = renderer.tensor
    photographs = [held(image, tensor) for image in room.photographs]
    grey = held(np.full_like(room.texels, _GREY), tensor)
    pyramid = rt.LaplacianPyramid(grey) if title.endswith(LEVELS) else None
    opt = dr.opt.Adam(lr=rate, params={"texels": grey} if pyramid is None else pyramid.levels)

    def texels(opt: Any) -> Any:
        return opt["texels"] if pyramid is None else dr.clip(pyramid.texture(opt), 0, 1)

    def step(state: Any, opt: Any, photographs: list[Any], number: Any) -> Any:
        renderer.params[TEXELS] = texels(opt)
        renderer.params.update()
        loss = 0
        for k, photograph in enumerate(photographs):
            image = renderer.image(k, samples, number * len(PLACES) + k)
            loss = loss + dr.mean(dr.square(image - photograph), axis=None)
        dr.backward(loss)
        opt.step()
        if pyramid is None:
            opt["texels"] = dr.clip(opt["texels"], 0, 1)
        return dr.detach(texels(opt))

    called = dr.freeze(step) if title.endswith(FROZEN) else step
    state = (room.ours, renderer.params) if title.endswith(FROZEN) else None
    curve: list[tuple[float, float]] = []
    total, steps, compiling, next_look = 0.0, 0, 0.0, 0.0
    while total < seconds:
        opt.set_learning_rate(dr.opaque(dr.llvm.ad.Float32, rate * 0.1 ** (total / seconds)))
        number = dr.opaque(dr.llvm.ad.UInt32, steps) if title.endswith(FROZEN) else steps
        dr.sync_thread()
        begin = time.perf_counter()
        # The first one makes tables, which no frozen function can.
        found = (called if steps else step)(state, opt, photographs, number)
        dr.eval(found)
        dr.sync_thread()
        elapsed = time.perf_counter() - begin
        steps += 1
        if steps <= _WARM_UP:
            compiling += elapsed
        else:
            total += elapsed
        if total >= next_look or total >= seconds:
            curve.append((total, float(np.sqrt(np.mean((found.numpy() - room.texels) ** 2)))))
            next_look = total * 1.03
    return Run(title, samples, rate, curve, steps, compiling, found.numpy())


def held(array: np.ndarray, tensor: Any) -> Any:
    """``array`` in memory of Dr.Jit's own, as frozen functions want it."""
    return tensor(owned(array, dr.llvm.ad.Float32), array.shape)


def best(title: str, runs: list[Run], target: float | None) -> Run:
    """Of ``runs`` the one that is first at ``target``; where none is there, or there is no target, the nearest in the
    end."""
    if target is not None:
        there = [r for r in runs if r.reaches(target) is not None]
        if there:
            return min(there, key=lambda r: r.reaches(target) or 0.0)
    return min(runs, key=lambda r: r.curve[-1][1])


def target_of(runs: dict[str, list[Run]]) -> float | None:
    """The error that Mitsuba comes to with its best setting."""
    theirs = [r for title, tried in runs.items() if title.startswith("Mitsuba") for r in tried]
    return min((e for r in theirs for _, e in r.curve), default=None)


def report(runs: dict[str, list[Run]], seconds: float) -> str:
    target = target_of(runs)
    rows = []
    for title, tried in runs.items():
        run = best(title, tried, None if title.startswith("Mitsuba") else target)
        reached = None if target is None else run.reaches(target)
        rows.append(
            [
                title,
                f"{run.samples} spp, rate {run.rate:g}",
                f"{1e3 * run.curve[-1][0] / max(run.steps - _WARM_UP, 1):.0f}",
                f"{run.error_at(5):.4f}",
                f"{min(e for r in tried for _, e in r.curve):.4f}",
                "never" if reached is None else f"{reached:.2f}",
                "" if reached is None else f"{seconds / reached:.1f}x",
                f"{run.compile_seconds:.1f}",
            ]
        )
    head = ["", "best setting", "ms a step", "error after 5 s", "least error", "s to Mitsuba's error",
            f"than {seconds:g} s", "s to compile"]  # fmt: skip
    line = (
        "" if target is None else f"\nMitsuba's least error within {seconds:g} s, of all its settings: {target:.4f}.\n"
    )
    return markdown_table(head, rows) + line


def picture(path: Path, runs: dict[str, list[Run]], room: Room) -> None:
    """Curves of some ways' best runs, and beside them the truth and the texels that they ended with."""
    target = target_of(runs)
    titles = [t for t in SHOWN if t in runs]
    chosen = {t: best(t, runs[t], None if t.startswith("Mitsuba") else target) for t in titles}
    curves = {t: [(s, e) for s, e in run.curve if s > 0] for t, run in chosen.items()}
    chart = log_charts("RMSE of texels over seconds of steps", {"error": curves}, "seconds")
    tiles = [(f"{t}: {run.curve[-1][1]:.3f} after {run.curve[-1][0]:.0f} s", run.texels) for t, run in chosen.items()]
    size = chart.shape[0]
    strips = [("", chart), *((title, _shown(t, size)) for title, t in [("truth", room.texels), *tiles])]
    contact_sheet(path, strips, columns=4, width=chart.shape[1])


def _shown(texels: np.ndarray, size: int) -> np.ndarray:
    image = Image.fromarray((np.clip(texels, 0, 1) ** (1 / 2.2) * 255).astype(np.uint8))
    return np.asarray(image.resize((size, size), Image.Resampling.NEAREST))


if __name__ == "__main__":
    raise SystemExit(main())
