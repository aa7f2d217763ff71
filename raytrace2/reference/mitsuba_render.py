"""Reference images rendered by Mitsuba: independent batches, timed, and kept on disk so that none is rendered twice."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
import time
import warnings
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .mitsuba_scene import Source, instantiate, mitsuba_errors, mitsuba_variant, parse

_FORMAT = 1
_SAMPLES_PER_PASS = 1 << 23


@dataclass(frozen=True, eq=False)
class Reference:
    """Mitsuba's render of a scene.

    ``batch_means`` is (B, H, W, 3) float32 linear RGB, each an independent image of ``spp / B`` samples a pixel.
    ``spp`` is what Mitsuba really took (its stratified samplers round up). Seconds: ``seconds_first`` for the first
    batch, kernel compilation included; ``seconds_best`` for the fastest batch; ``seconds`` for ``spp`` samples at that
    best pace, which is what a warm render costs; ``seconds_load`` for parsing and building the scene. From the cache
    they are those of the render that filled it."""

    batch_means: np.ndarray
    spp: int
    seconds: float
    seconds_first: float
    seconds_best: float
    seconds_load: float
    from_cache: bool
    key: str
    settings: dict[str, Any]

    @property
    def image(self) -> np.ndarray:
        """The mean of all batches, (H, W, 3) float32."""
        return self.batch_means.mean(axis=0, dtype=np.float64).astype(np.float32)

    @property
    def variance(self) -> np.ndarray:
        """Estimated variance of ``image``, (H, W, 3) float64; NaN when there is one batch only."""
        n = len(self.batch_means)
        if n < 2:
            return np.full(self.batch_means.shape[1:], np.nan)
        return self.batch_means.var(axis=0, ddof=1, dtype=np.float64) / n


def default_cache_dir() -> Path:
    """``$RAYTRACE2_CACHE``, else the user's cache folder (``$XDG_CACHE_HOME`` or ``~/.cache``) followed by
    ``raytrace2``."""
    own = os.environ.get("RAYTRACE2_CACHE")
    if own:
        return Path(own)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "raytrace2"


def render_reference(
    source: Source,
    *,
    spp: int,
    batches: int = 16,
    seed: int = 0,
    sensor: int = 0,
    size: tuple[int, int] | None = None,
    resolution_scale: float = 1.0,
    integrator: Mapping[str, Any] | None = None,
    sampler: str | None = None,
    parameters: Mapping[str, Any] | None = None,
    variant: str = "llvm_ad_rgb",
    cache_dir: str | os.PathLike[str] | None = None,
) -> Reference:
    """Renders ``source`` (path of an XML file, XML text, or Mitsuba dict) with Mitsuba in ``batches`` independent
    batches.

    ``spp`` samples a pixel in all, a multiple of ``batches``. The film is ``size`` (width, height) pixels, or its own
    size times ``resolution_scale``; a crop window scales along. ``integrator`` is a Mitsuba dict that takes the place
    of the scene's (``{"type": "path", "max_depth": 3}``), ``sampler`` the name of a sampler plugin that takes the place
    of the scene's, ``parameters`` the values of an XML scene's ``$parameters``. The user's variant is restored.

    Results are kept in ``cache_dir`` (default: :func:`default_cache_dir`) under a digest of the scene with its files,
    of all settings and of the versions of Mitsuba and Dr.Jit; a damaged cache file is rendered anew. A dict that holds
    live Mitsuba objects is rendered every time. ``SceneError`` for a scene that Mitsuba refuses, ``ValueError`` for
    impossible settings."""
    if batches < 1 or spp < 1 or spp % batches:
        raise ValueError(f"spp must be a positive multiple of batches, not spp={spp} with batches={batches}")
    if resolution_scale <= 0.0 or (size is not None and (len(size) != 2 or min(size) < 1)):
        raise ValueError(f"the film needs at least one pixel: size={size}, resolution_scale={resolution_scale}")
    directory = Path(cache_dir) if cache_dir is not None else default_cache_dir()
    with mitsuba_variant(variant) as mi:
        import drjit as dr

        started = time.perf_counter()
        parsed = parse(mi, source, parameters or {}, sensor, size, resolution_scale, sampler)
        settings: dict[str, Any] = {
            "mitsuba": mi.__version__,
            "drjit": dr.__version__,
            "variant": variant,
            "spp": spp,
            "batches": batches,
            "seed": seed,
            "sensor": sensor,
            "width": parsed.size[0],
            "height": parsed.size[1],
            "integrator": dict(integrator) if integrator else None,
            "sampler": sampler,
        }
        key = _key(parsed.digest, settings)
        file = directory / f"reference-{key}.npz"
        if key:
            cached = _read(file, key, (batches, parsed.size[1], parsed.size[0], 3))
            if cached is not None:
                return cached
        scene = instantiate(mi, parsed, source)
        with mitsuba_errors(source):
            override = mi.load_dict(dict(integrator)) if integrator else None
            seconds_load = time.perf_counter() - started
            means, taken, seconds = _render(mi, scene, override, sensor, spp // batches, batches, seed)
    reference = Reference(
        means, taken * batches, min(seconds) * batches, seconds[0], min(seconds), seconds_load, False, key, settings
    )
    if key:
        _write(file, reference)
    return reference


def _render(
    mi: Any, scene: Any, integrator: Any, sensor: int, spp: int, batches: int, seed: int
) -> tuple[np.ndarray, int, list[float]]:
    """Batch means, the samples per pixel that each batch really took, and the seconds of each."""
    camera = scene.sensors()[sensor]
    width, height = (int(n) for n in camera.film().crop_size())
    camera.sampler().set_sample_count(spp)
    taken = int(camera.sampler().sample_count())
    # Mitsuba refuses wavefronts of 2^32 samples, and memory ends before that: big batches are split into equal passes.
    most = max(1, _SAMPLES_PER_PASS // (width * height))
    passes = next(n for n in range(1, taken + 1) if taken % n == 0 and taken // n <= most)
    extra = {} if integrator is None else {"integrator": integrator}
    means = np.empty((batches, height, width, 3), dtype=np.float32)
    seconds = []
    for batch in range(batches):
        started = time.perf_counter()
        total = np.zeros((height, width, 3))
        for i in range(passes):
            index = (seed * batches + batch) * passes + i
            image = mi.render(scene, sensor=sensor, spp=taken // passes, seed=index % 2**32, **extra)
            total += _rgb(np.asarray(image))
        means[batch] = total / passes
        seconds.append(time.perf_counter() - started)
    return means, taken, seconds


def _rgb(image: np.ndarray) -> np.ndarray:
    """The colour channels: all three, the one of a luminance film three times; alpha and AOVs follow them and are left
    out."""
    return image[..., :3] if image.shape[2] >= 3 else np.repeat(image[..., :1], 3, axis=2)


def _key(scene_digest: str | None, settings: Mapping[str, Any]) -> str:
    """Empty when the render cannot be cached: its scene or integrator holds more than plain data."""
    if scene_digest is None:
        return ""
    try:
        text = json.dumps([_FORMAT, scene_digest, settings], sort_keys=True)
    except TypeError:
        return ""
    return hashlib.sha256(text.encode()).hexdigest()[:40]


def _read(file: Path, key: str, shape: tuple[int, ...]) -> Reference | None:
    """None when there is no such file or it is not whole."""
    try:
        with np.load(file, allow_pickle=False) as stored:
            means, text = stored["batch_means"], str(stored["meta"])
        meta = json.loads(text)
        # NumPy does not always read to the end of a member, where zipfile would check its sum.
        whole = meta.pop("sha256") == hashlib.sha256(means.tobytes()).hexdigest()
        if not whole or meta.pop("key") != key or means.shape != shape or means.dtype != np.float32:
            return None
        return Reference(batch_means=means, from_cache=True, key=key, **meta)
    except FileNotFoundError:
        return None
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
        EOFError,
        zipfile.BadZipFile,
        zlib.error,
        NotImplementedError,
    ):
        return None


def _write(file: Path, reference: Reference) -> None:
    """Under a temporary name first, so that no reader ever meets half a file; a disk that refuses costs the cache
    only."""
    meta = {
        name: getattr(reference, name)
        for name in ("spp", "seconds", "seconds_first", "seconds_best", "seconds_load", "key", "settings")
    }
    meta["sha256"] = hashlib.sha256(reference.batch_means.tobytes()).hexdigest()
    temporary: str | None = None
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=file.parent, suffix=".tmp", delete=False) as stream:
            temporary = stream.name
            np.savez(stream, batch_means=reference.batch_means, meta=np.array(json.dumps(meta)))
        os.replace(temporary, file)
    except OSError as error:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)
        warnings.warn(f"the reference image could not be cached: {error}", stacklevel=3)
