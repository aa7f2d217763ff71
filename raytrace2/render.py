"""Rendering: a scene, a camera and an integrator to an image, in passes that bound memory."""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr

from .arguments import whole_number
from .errors import SettingError
from .film import Film
from .filtering import Filtering, plan_filtering
from .integrators.aov import aov, channel_names, needs_offset_rays
from .integrators.direct import direct
from .integrators.path import path
from .rays.camera import make_camera
from .rays.differentials import make_differentials
from .rays.ray import Ray
from .rays.sampler import Sampler, make_sampler
from .rays.wavefront import split_passes
from .render_arguments import check_integrator, check_names, check_scene, check_work, checked_counts, checked_size
from .scene.description import Camera, Integrator, PerspectiveCamera
from .scene.field_of_view import fov_along, x_fov_of
from .scene.scene import Scene
from .scene.traced import TracedScene
from .types import types

#: Lanes of a pass: enough to keep every core busy for a second or so, few enough for a few hundred megabytes.
MAX_LANES = 1 << 21

_RADIANCE: dict[str, Callable[..., Any]] = {"path": path, "direct": direct}


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
    params: None = None,
    sensor: int = 0,
    integrator: Integrator | str | None = None,
    seed: int = 0,
    spp: int = 1,
    accel: str | None = None,
    filter: str | None = None,
    differentials: str | None = None,
    precision: str = "float32",
    *,
    size: tuple[int, int] | None = None,
    intersection: str | None = None,
    progress: bool | None = None,
) -> Any:
    """Renders ``scene`` and returns its image, TensorXf (height, width, channels), linear, as ``mi.render`` does.

    ``sensor`` counts the scene's cameras. ``integrator`` is ``"path"``, ``"direct"``, a
    :class:`description.Integrator` or None for the scene's own; with aovs the colour comes first and then their
    channels. ``spp`` samples a pixel, 0 for the count in the scene. ``accel`` names the structure (``"bvh"``,
    ``"brute_force"``, options after a colon). ``filter`` (``"bilinear"``, ``"ewa"``, ``"exact"`` ...: see
    ``rt.filter_names()``; options after a colon) takes the place of the scene's choice, or of every bitmap's own, and
    ``differentials`` (``"autodiff"``, ``"none"`` ...) say how rays know the footprints that it covers: see
    :func:`~raytrace2.filtering.plan_filtering`. ``precision`` is ``"float32"`` or ``"float64"``; ``size`` (width,
    height) replaces the film's. ``intersection`` is ``"watertight"``, ``"fast"`` (see ``rt.accel.build``) or None for
    the scene's own. ``progress`` shows a bar; None shows one on a terminal if there is more than one pass.

    Ctrl-C raises :class:`RenderInterrupted`, which holds the image so far. The same arguments give the same image
    to the bit.
    """
    if params is not None:
        raise TypeError("params: pass None; parameters are changed in the scene before it is loaded")
    return render_detailed(
        scene, sensor, integrator, seed=seed, spp=spp, accel=accel, filter=filter, differentials=differentials,
        precision=precision, size=size, intersection=intersection, progress=progress,
    ).image  # fmt: skip


def render_detailed(
    scene: Scene,
    sensor: int = 0,
    integrator: Integrator | str | None = None,
    *,
    seed: int = 0,
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
    check_scene(scene)
    check_integrator(integrator)
    check_names(accel=accel, filter=filter, differentials=differentials, intersection=intersection)
    spp, seed = checked_counts(spp, seed)
    camera_settings = choose_camera(scene, sensor, size)
    settings = choose_integrator(scene, integrator)
    begin = time.perf_counter()
    if precision not in ("float32", "float64"):
        raise SettingError(f"precision must be 'float32' or 'float64', not {precision!r}")
    sampler = make_sampler(camera_settings.sampler, types(precision), spp if spp != 0 else None)
    asked = filter or scene.filter, differentials or scene.differentials
    filtering = plan_filtering(*asked, camera_settings.film, sampler.sample_count)
    traced = scene.traced(accel, precision, filtering.textures, intersection)
    if settings.kind != "aov" or settings.nested is not None or any(kind == "albedo" for _, kind in settings.aovs):
        traced.prepare_shading()
    camera = make_camera(camera_settings, traced.types)
    names = [] if settings.kind == "aov" and settings.nested is None else ["R", "G", "B"]
    names += channel_names(settings)
    check_work(filtering.film, len(names), sampler.sample_count, max_lanes)
    film = Film(filtering.film, traced.types, len(names))
    view = _View(camera, film, filtering, sampler.sample_count)
    passes = split_passes(film.pixel_count, sampler.sample_count, max_lanes)
    if camera_settings.film.pixel_format == "luminance" and names[:3] == ["R", "G", "B"]:
        names[:3] = ["Y"]
    prepared = time.perf_counter()

    def finished(samples: int) -> Rendering:
        image = film.develop()
        dr.eval(image)
        dr.sync_thread()
        traced.structure.check_turns()
        bad = film.non_finite_samples()
        if bad:
            message = f"{bad} samples were NaN or infinite and were left out of the image"
            warnings.warn(message, RuntimeWarning, stacklevel=4)
        return Rendering(image, names, samples, prepared - begin, time.perf_counter() - prepared)

    some, complete = False, 0
    with _bar(progress, len(passes)) as bar:
        try:
            for wavefront in passes:
                sampler.seed(seed, wavefront)
                pixel, _ = wavefront.pixel_and_sample()
                offset = sampler.next_2d()
                if filtering.centred:
                    offset = type(offset)(0.5, 0.5)
                values = _sample(traced, settings, view, sampler, pixel, offset)
                film.add(wavefront, offset, values)
                dr.sync_thread()
                some = True
                if wavefront.first_pixel + wavefront.pixels == film.pixel_count:
                    complete = wavefront.first_sample + wavefront.samples
                bar.update()
        except KeyboardInterrupt:
            raise RenderInterrupted(finished(complete) if some else None) from None
    return finished(sampler.sample_count)


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
    """The scene's integrator, or the one asked for by name or in full."""
    if integrator is None:
        return scene.description.integrator
    if isinstance(integrator, str):
        if integrator not in _RADIANCE:
            raise SettingError(
                f"unknown integrator {integrator!r}: there are {', '.join(_RADIANCE)} (aov needs settings)"
            )
        return Integrator(kind=integrator)  # type: ignore[arg-type]
    return integrator


class _View:
    """A camera, its film, and how rays through it know how far apart they are."""

    def __init__(self, camera: Any, film: Film, filtering: Filtering, sample_count: int) -> None:
        self.camera, self.film = camera, film
        # Samples of a pixel lie the closer together the more there are (Igehy 1999; Mitsuba does the same).
        spacing = sample_count**-0.5
        Float = film.types.Float
        self.step = dr.opaque(Float, spacing / film.width), dr.opaque(Float, spacing / film.height)
        self.differentials = make_differentials(filtering.differentials, self.step, spacing)


def _sample(
    traced: TracedScene, settings: Integrator, view: _View, sampler: Sampler, pixel: Any, offset: Any
) -> list[Any]:
    """The values of one sample a lane: colour, then aovs."""
    camera, differentials = view.camera, view.differentials
    position = view.film.position(pixel, offset)
    aperture = sampler.next_2d() if camera.needs_aperture_sample else None
    radiance = settings if settings.kind != "aov" else settings.nested
    ray, differential = differentials.start(camera, position, aperture)
    values: list[Any] = []
    if radiance is not None:
        integrate = _RADIANCE[radiance.kind]
        found = integrate(traced, radiance, sampler, ray, differentials=differentials, differential=differential)
        values.extend(found)
    if settings.kind == "aov":
        needed = differential is None and needs_offset_rays(settings)
        offsets = _offset_rays(view, position, aperture) if needed else None
        found = aov(traced, settings, ray, offsets, differentials=differentials, differential=differential)
        values = [*values, *found]
    return values


def _offset_rays(view: _View, position: Any, aperture: Any) -> tuple[Ray, Ray]:
    """Rays towards the next sample to the right and down."""
    step = type(position)
    right, down = step(view.step[0], 0), step(0, view.step[1])
    return view.camera.sample_ray(position + right, aperture), view.camera.sample_ray(position + down, aperture)


def _bar(progress: bool | None, passes: int) -> Any:
    from tqdm import tqdm

    show = progress if progress is not None else passes > 1 and sys.stderr.isatty()
    return tqdm(total=passes, disable=not show, unit="pass", desc="render")
