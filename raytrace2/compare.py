"""Our image beside Mitsuba's: how far apart they are, whether by more than noise, and what each cost."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import numpy as np

from .errors import RayTraceError
from .reference.comparison import Comparison, compare_batches
from .reference.mitsuba_render import render_reference
from .render import choose_integrator, render_detailed
from .scene.description import Integrator
from .scene.scene import Scene

#: Our samplers draw Mitsuba's numbers from Mitsuba's seeds; a noise test needs the two sides independent, so ours
#: start here.
SEED_OFFSET = 1 << 31

#: Renders with seeds of their own, on each side, that the noise is estimated from.
BATCHES = 16


def compare(
    scene: Scene,
    sensor: int = 0,
    integrator: Integrator | str | None = None,
    *,
    spp: int = 64,
    reference_spp: int | None = None,
    seed: int = 0,
    accel: str | None = None,
    filter: str | None = None,
    differentials: str | None = None,
    precision: str = "float32",
    size: tuple[int, int] | None = None,
    intersection: str | None = None,
    cache_dir: str | os.PathLike[str] | None = None,
    progress: bool | None = None,
) -> Comparison:
    """Renders ``scene`` with raytrace2 and with Mitsuba and compares the two.

    Ours has ``spp`` samples a pixel, Mitsuba's ``reference_spp`` (None: as many), each in 16 independent batches of
    at least one sample (counts are rounded up to whole batches). Whether the two differ by more than noise is asked
    of batches of one size, so with a larger ``reference_spp`` Mitsuba also renders one of ``spp``. References are
    kept on disk, see :func:`raytrace2.reference.mitsuba_render.render_reference`. The other arguments are those of
    :func:`render`.

    The result shows itself in a notebook, and ``result.report(path)`` writes it as a web page.
    """
    if scene.origin is None:
        raise RayTraceError(
            "this scene was not loaded by rt.load_file, load_string or load_dict: Mitsuba cannot load it"
        )
    if scene.store.entries:
        names = ", ".join(sorted(entry.key for entry in scene.store.entries.values())[:3])
        raise RayTraceError(
            f"{names} changed since this scene was loaded, which Mitsuba does anew; compare it unchanged"
        )
    settings = choose_integrator(scene, integrator)
    if settings.kind == "aov":
        if settings.nested is None:
            raise RayTraceError(
                "an aov integrator without a nested one has no colour to compare; add a nested integrator"
            )
        settings = settings.nested
    each = max(1, -(-spp // BATCHES))
    each_reference = each if reference_spp is None else max(1, -(-reference_spp // BATCHES))
    ours, seconds = _batches(
        scene, sensor, settings, each, seed, progress, accel=accel, filter=filter,
        differentials=differentials, precision=precision, size=size, intersection=intersection,
    )  # fmt: skip
    film = scene.description.cameras[sensor].film

    def reference(samples: int) -> Any:
        return render_reference(
            scene.origin, spp=samples * BATCHES, batches=BATCHES, seed=seed, sensor=sensor,
            size=size or (film.width, film.height), integrator=_as_dict(settings), parameters=scene.parameters,
            cache_dir=cache_dir,
        )  # fmt: skip

    theirs = reference(each_reference)
    fair = theirs if each_reference == each else reference(each)
    title = Path(scene.description.source).stem if scene.description.source else "scene"
    rows = {
        "Scene": scene.description.source or "in memory",
        "Integrator": f"{settings.kind}, max_depth {settings.max_depth}",
        "Samples per pixel": f"{each * BATCHES} (Mitsuba {theirs.spp})",
        "Structure": f"{accel or scene.accel}, {intersection or scene.intersection}",
        "Precision": precision,
        "Mitsuba": f"{theirs.settings['mitsuba']}, {theirs.settings['variant']}",
    }
    return compare_batches(
        ours, theirs.batch_means, title=title, seconds=seconds * BATCHES, reference_seconds=theirs.seconds,
        settings=rows,
        noise_reference=None if fair is theirs else fair.batch_means,
    )  # fmt: skip


def _batches(
    scene: Scene, sensor: int, settings: Integrator, each: int, seed: int, progress: bool | None, **options: Any
) -> tuple[np.ndarray, float]:
    """Images of independent batches (B, H, W, 3) and the seconds of the fastest one, which is what a warm render
    takes."""
    from tqdm import tqdm

    images, best = [], np.inf
    for k in tqdm(range(BATCHES), desc="raytrace2", unit="batch", disable=None if progress is None else not progress):
        begin = time.perf_counter()
        done = render_detailed(
            scene, sensor, settings, seed=SEED_OFFSET + seed * BATCHES + k, spp=each, progress=False, **options
        )
        image = np.array(done.image)
        best = min(best, time.perf_counter() - begin)
        images.append(image if image.shape[2] == 3 else np.repeat(image[..., :1], 3, axis=2))
    return np.stack(images).astype(np.float32), float(best)


def _as_dict(settings: Integrator) -> dict[str, Any]:
    """The settings as a Mitsuba dict."""
    result: dict[str, Any] = {"type": settings.kind, "hide_emitters": settings.hide_emitters}
    if settings.kind == "path":
        return {**result, "max_depth": settings.max_depth, "rr_depth": settings.rr_depth}
    return {**result, "emitter_samples": settings.emitter_samples, "bsdf_samples": settings.bsdf_samples}
