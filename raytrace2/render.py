"""Rendering: a scene, a camera and an integrator to an image, in passes that bound memory."""

from __future__ import annotations

import sys
import time
import warnings
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr

from .arguments import whole_number
from .differentiable import differentiable, unlike
from .errors import SettingError
from .integrators.aov import check_aovs, parse_aovs
from .job import RADIANCE, Choices, Job
from .parameters.scene_parameters import SceneParameters
from .render_arguments import (
    check_integrator,
    check_names,
    check_scene,
    checked_counts,
    checked_size,
    checked_visibility,
)
from .scene.description import Camera, Integrator, PerspectiveCamera
from .scene.field_of_view import fov_along, x_fov_of
from .scene.scene import Scene

#: Lanes of a pass: enough to keep every core busy for a second or so, few enough for a few hundred megabytes.
MAX_LANES = 1 << 21


@dataclass(frozen=True)
class Rendering:
    """An image (TensorXf, height x width x channels) with the names of its channels, the samples per pixel that
    were taken, and
    the seconds that preparing (structure, tables) and rendering took."""

    image: Any
    channels: list[str]
    spp: int
    prepare_seconds: float
    seconds: float


class RenderInterrupted(KeyboardInterrupt):
    """Ctrl-C during a render. ``partial`` holds what was done: ``partial.spp`` samples of every pixel, and of some
    pixels
    more; None if not even one pass was."""

    def __init__(self, partial: Rendering | None) -> None:
        super().__init__(f"interrupted after {partial.spp if partial else 0} samples per pixel")
        self.partial = partial

    @property
    def image(self) -> Any:
        """The image of ``partial``, or None."""
        return self.partial.image if self.partial else None


def render(
    scene: Scene,
    params: SceneParameters | None = None,
    sensor: int = 0,
    integrator: Integrator | str | None = None,
    seed: Any = 0,
    spp: int = 1,
    accel: str | None = None,
    filter: str | None = None,
    differentials: str | None = None,
    precision: str | None = None,
    *,
    size: tuple[int, int] | None = None,
    intersection: str | None = None,
    progress: bool | None = None,
    spp_grad: int = 0,
    seed_grad: Any = None,
    footprint_gradients: bool = True,
    visibility_gradients: bool | int = False,
    deterministic: bool = False,
) -> Any:
    """Renders ``scene`` and returns its image, TensorXf (height, width, channels), linear, as ``mi.render`` does.

    ``sensor`` counts the scene's cameras. ``integrator`` is ``"path"``, ``"direct"``, ``"aov:depth,sh_normal"`` (any of
    :data:`~raytrace2.integrators.aov.CHANNELS`), a :class:`~raytrace2.scene.description.Integrator` or None for the
    scene's own; with aovs the colour of the integrator that is nested in them, if one is, comes first and then their
    channels, which have derivatives as colours do (those that count or number have none). ``spp`` samples a pixel, 0
    for the count in the scene. ``accel`` names the structure (``"bvh"``, ``"brute_force"``, options after a colon).
    ``filter`` (``"bilinear"``, ``"ewa"``, ``"exact"`` ...: see ``rt.filter_names()``; options after a colon) takes the
    place of the scene's choice, or of every bitmap's own, and ``differentials`` (``"autodiff"``, ``"none"`` ...) say
    how rays know the footprints that it covers: see :func:`~raytrace2.filtering.plan_filtering`. ``seed`` is a whole
    number, or a UInt of Dr.Jit. ``precision`` is ``"float32"`` or ``"float64"``; ``size`` (width, height) replaces the
    film's. ``intersection`` is ``"watertight"``, ``"fast"`` (see ``rt.accel.build``) or None for the scene's own.
    ``progress`` shows a bar; None shows one on a terminal if there is more than one pass.

    With the scene's ``params`` (:func:`~raytrace2.traverse`; ``precision`` is then theirs unless given) of which some
    carry derivatives, the image is a differentiable function of these, in reverse and in forward mode. Derivatives take
    ``spp_grad`` samples a pixel of their own (0: as many as the image), drawn from ``seed_grad`` (None: from another
    sequence than the image's; the image's own seed gives the derivative of that very image). They are those inside
    surfaces and shadows: that edges move is not seen, but for ``visibility_gradients``, which costs: True takes as many
    points of moving edges as there are samples, a number so many (see :mod:`raytrace2.boundary`).
    ``footprint_gradients``: footprints of texture filters depend on the camera and on surfaces; without, they count as
    constant, as how they change from pixel to pixel (``"autodiff2"``) always does. ``deterministic``: gradients, too,
    are the same to the bit from run to run; on one thread.

    It may be part of a function that Dr.Jit freezes (``dr.freeze``) and that has ``scene`` or ``params`` and the seed
    among its arguments, if the same render was done once before; samples that are not finite are then left out without
    a warning, and surfaces may move only between calls.

    Ctrl-C raises :class:`RenderInterrupted`, which holds the image so far. The same arguments give the same image
    to the bit.
    """
    precision = _precision(scene, params, precision)
    how: dict[str, Any] = {
        "accel": accel, "filter": filter, "differentials": differentials, "precision": precision, "size": size,
        "intersection": intersection,
    }  # fmt: skip
    moving = params is not None and bool(params.with_derivatives())
    image = render_detailed(scene, sensor, integrator, seed=seed, spp=spp, progress=progress, **how).image
    if not moving:
        return image
    spp_grad, seed_grad = checked_counts(spp_grad or spp, unlike(seed) if seed_grad is None else seed_grad)
    again = Job.of(scene, _choices(scene, sensor, integrator, seed=seed_grad, spp=spp_grad, **how))
    if dr.flag(dr.JitFlag.FreezingScope):
        _check_frozen(visibility_gradients, deterministic)
    return differentiable(image, again, footprint_gradients, checked_visibility(visibility_gradients), deterministic)


def render_detailed(
    scene: Scene,
    sensor: int = 0,
    integrator: Integrator | str | None = None,
    *,
    seed: Any = 0,
    spp: int = 1,
    accel: str | None = None,
    filter: str | None = None,
    differentials: str | None = None,
    precision: str = "float32",
    size: tuple[int, int] | None = None,
    intersection: str | None = None,
    progress: bool | None = None,
    max_lanes: int = MAX_LANES,
) -> Rendering:
    """:func:`render` with what it took; ``max_lanes`` bounds the samples of a pass."""
    choices = _choices(
        scene, sensor, integrator, seed=seed, spp=spp, accel=accel, filter=filter, differentials=differentials,
        precision=precision, size=size, intersection=intersection, max_lanes=max_lanes,
    )  # fmt: skip
    begin = time.perf_counter()
    return render_job(Job.of(scene, choices), progress, begin)


def _choices(
    scene: Scene, sensor: int, integrator: Integrator | str | None, *, seed: Any, spp: int, accel: str | None,
    filter: str | None, differentials: str | None, precision: str, size: tuple[int, int] | None,
    intersection: str | None, max_lanes: int = MAX_LANES,
) -> Choices:  # fmt: skip
    check_scene(scene)
    check_integrator(integrator)
    check_names(accel=accel, filter=filter, differentials=differentials, intersection=intersection)
    spp, seed = checked_counts(spp, seed)
    if precision not in ("float32", "float64"):
        raise SettingError(f"precision must be 'float32' or 'float64', not {precision!r}")
    return Choices(
        sensor, choose_camera(scene, sensor, size), choose_integrator(scene, integrator), seed, spp, accel, filter,
        differentials, precision, intersection, max_lanes,
    )  # fmt: skip


def _check_frozen(visibility: bool | int, deterministic: bool) -> None:
    if visibility:
        raise SettingError("edges are found outside of kernels: no visibility_gradients in a function that is frozen")
    if deterministic:
        raise SettingError("frozen functions know of no threads: dr.set_thread_count(1) makes them deterministic")


def _precision(scene: Scene, params: SceneParameters | None, precision: str | None) -> str:
    if params is None:
        return precision or "float32"
    if not isinstance(params, SceneParameters) or params.scene is not scene:
        raise SettingError("params must be what rt.traverse gave for this scene")
    return precision or params.types.precision


def render_job(job: Job, progress: bool | None, begin: float) -> Rendering:
    """The image of ``job``, whose preparation began at ``begin``."""
    prepared = time.perf_counter()
    film, passes = job.view.film, job.passes

    def finished(samples: int) -> Rendering:
        image = film.develop()
        dr.eval(image)
        if dr.flag(dr.JitFlag.FreezingScope):
            # Nothing can be looked at, nor waited for.
            return Rendering(image, job.channels, samples, prepared - begin, time.perf_counter() - prepared)
        dr.sync_thread()
        job.traced.structure.check_turns()
        bad = film.non_finite_samples()
        if bad:
            message = f"{bad} samples were NaN or infinite and were left out of the image"
            warnings.warn(message, RuntimeWarning, stacklevel=4)
        return Rendering(image, job.channels, samples, prepared - begin, time.perf_counter() - prepared)

    some, complete = False, 0
    with _bar(progress, len(passes)) as bar:
        try:
            for wavefront in passes:
                job.render_pass(wavefront)
                some = True
                if wavefront.first_pixel + wavefront.pixels == film.pixel_count:
                    complete = wavefront.first_sample + wavefront.samples
                bar.update()
        except KeyboardInterrupt:
            raise RenderInterrupted(finished(complete) if some else None) from None
    return finished(job.sampler.sample_count)


def choose_camera(scene: Scene, sensor: int, size: tuple[int, int] | None) -> Camera:
    """The description of camera ``sensor``, its film resized if ``size`` is given (a crop window scales along)."""
    check_scene(scene)
    cameras = scene.cameras
    sensor = whole_number(sensor, "sensor")
    if not 0 <= sensor < len(cameras):
        raise SettingError(f"sensor {sensor} does not exist: the scene has {len(cameras)}")
    camera = cameras[sensor]
    if size is None:
        return camera
    width, height = checked_size(size)
    film = camera.film
    sx, sy = width / film.width, height / film.height
    left, top = round(film.crop_offset_x * sx), round(film.crop_offset_y * sy)
    film = replace(
        film, width=width, height=height, crop_offset_x=left, crop_offset_y=top,
        crop_width=min(max(round(film.crop_width * sx), 1), width - left),
        crop_height=min(max(round(film.crop_height * sy), 1), height - top),
    )  # fmt: skip
    if isinstance(camera, PerspectiveCamera):
        old, new = camera.film.width / camera.film.height, width / height
        fov = fov_along(camera.x_fov, camera.fov_axis, old)
        return replace(camera, film=film, x_fov=x_fov_of(fov, camera.fov_axis, new))
    return replace(camera, film=film)


def choose_integrator(scene: Scene, integrator: Integrator | str | None) -> Integrator:
    """The scene's integrator, or the one asked for by name or in full; ``SettingError`` for names and aovs that there
    are not."""
    if integrator is None:
        found = scene.description.integrator
    elif isinstance(integrator, Integrator):
        found = integrator
    else:
        kind, _, listed = integrator.partition(":")
        if kind == "aov":
            found = Integrator("aov", aovs=parse_aovs(listed))
        elif integrator in RADIANCE:
            found = Integrator(kind=integrator)  # type: ignore[arg-type]
        else:
            raise SettingError(f"unknown integrator {integrator!r}: there are {', '.join(RADIANCE)} and aov:KIND,KIND")
    if found.kind == "aov":
        check_aovs(found.aovs)
    light = found.nested if found.kind == "aov" else found
    if light is not None and light.kind not in RADIANCE:
        raise SettingError(f"no integrator {light.kind!r} finds light: there are {', '.join(RADIANCE)}")
    return found


def _bar(progress: bool | None, passes: int) -> Any:
    from tqdm import tqdm

    show = progress if progress is not None else passes > 1 and sys.stderr.isatty()
    return tqdm(total=passes, disable=not show, unit="pass", desc="render")
