"""What a render comes down to once its arguments are settled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr

from .film import Film
from .filtering import Filtering, plan_filtering
from .integrators.aov import CHANNELS, COUNTED, aov, channel_names, needs_offset_rays
from .integrators.direct import direct
from .integrators.path import path
from .live import Slot
from .parameters.cameras import live_camera
from .rays.differentials import make_differentials
from .rays.ray import Ray
from .rays.sampler import Sampler, make_sampler
from .rays.wavefront import Wavefront, split_passes
from .render_arguments import check_work
from .scene.description import Camera, Integrator
from .scene.scene import Scene
from .scene.traced import TracedScene
from .types import types

#: Integrators of light, by name.
RADIANCE: dict[str, Callable[..., Any]] = {"path": path, "direct": direct}


@dataclass(frozen=True)
class Choices:
    """How a scene is rendered, names checked: see :func:`~raytrace2.render.render`."""

    sensor: int
    camera: Camera
    integrator: Integrator
    seed: Any
    spp: int
    accel: str | None
    filter: str | None
    differentials: str | None
    precision: str
    intersection: str | None
    max_lanes: int


class View:
    """A camera, its film, and how rays through it know how far apart they are."""

    def __init__(self, camera: Any, film: Film, filtering: Filtering, sample_count: int) -> None:
        self.camera, self.film = camera, film
        # Samples of a pixel lie the closer together the more there are (Igehy 1999; Mitsuba does the same).
        spacing = sample_count**-0.5
        Float = film.types.Float
        self.spacing = spacing
        self.step = dr.opaque(Float, spacing / film.width), dr.opaque(Float, spacing / film.height)
        self.differentials = make_differentials(filtering.differentials, self.step, spacing)


@dataclass(frozen=True, eq=False)
class Job:
    """A scene with its tables, a view of it and the passes that make the image, whose channels have ``names``."""

    traced: TracedScene
    camera_slots: tuple[Slot, ...]
    settings: Integrator
    filtering: Filtering
    view: View
    sampler: Sampler
    seed: Any
    passes: list[Wavefront]
    names: list[str]

    @staticmethod
    def of(scene: Scene, c: Choices) -> Job:
        """Makes structure and tables, if they are not there yet."""
        settings = c.integrator
        sampler = make_sampler(c.camera.sampler, types(c.precision), c.spp if c.spp != 0 else None)
        asked = c.filter or scene.filter, c.differentials or scene.differentials
        filtering = plan_filtering(*asked, c.camera.film, sampler.sample_count)
        traced = scene.traced(c.accel, c.precision, filtering.textures, c.intersection)
        if settings.kind != "aov" or settings.nested is not None or any(kind == "albedo" for _, kind in settings.aovs):
            traced.prepare_shading()
        camera, held = live_camera(scene, c.sensor, c.camera, traced.types)
        names = [] if settings.kind == "aov" and settings.nested is None else ["R", "G", "B"]
        names += channel_names(settings)
        check_work(filtering.film, len(names), sampler.sample_count, c.max_lanes)
        # Aovs that no colour comes before are not colours.
        desc = filtering.film if names[:3] == ["R", "G", "B"] else replace(filtering.film, pixel_format="rgb")
        film = Film(desc, traced.types, len(names))
        passes = split_passes(film.pixel_count, sampler.sample_count, c.max_lanes)
        view = View(camera, film, filtering, sampler.sample_count)
        return Job(traced, held, settings, filtering, view, sampler, c.seed, passes, names)

    def moving(self) -> tuple[list[Slot], list[Any]]:
        """The places of values that carry derivatives, and those values."""
        traced = self.traced
        values = traced.store.values(traced.types)
        of_camera = zip(self.camera_slots, (slot.made(values) for slot in self.camera_slots), strict=True)
        pairs = [*zip(traced.slots, traced.live_values(), strict=True), *of_camera]
        found = [(slot, value) for slot, value in pairs if dr.grad_enabled(value)]
        return [slot for slot, _ in found], [value for _, value in found]

    @property
    def radiance(self) -> Integrator | None:
        """The integrator of light, whose colour comes first; None where there are aovs alone."""
        return self.settings.nested if self.settings.kind == "aov" else self.settings

    @property
    def of_light(self) -> Job | None:
        """The same without aovs; None where there is nothing else."""
        return None if self.radiance is None else replace(self, settings=self.radiance)

    @property
    def ends_at_edges(self) -> list[bool]:
        """For each of the ``names``, whether it jumps where surfaces end, rather than anywhere."""
        colours = [True] * (0 if self.radiance is None else 3)
        anywhere = set(COUNTED) - {"shape_index"}
        return colours + [kind not in anywhere for _, kind in self.settings.aovs for _ in CHANNELS[kind]]

    @property
    def channels(self) -> list[str]:
        """The names of the image's channels."""
        if self.view.film.pixel_format == "luminance" and self.names[:3] == ["R", "G", "B"]:
            return ["Y", *self.names[3:]]
        return self.names

    def begin(self, wavefront: Wavefront) -> tuple[Any, Any, Any]:
        """Seeds the sampler for a pass: where in its pixel each sample lies, where on the film, and on the lens."""
        self.sampler.seed(self.seed, wavefront)
        pixel, _ = wavefront.pixel_and_sample()
        offset = self.sampler.next_2d()
        if self.filtering.centred:
            offset = type(offset)(0.5, 0.5)
        position = self.view.film.position(pixel, offset)
        aperture = self.sampler.next_2d() if self.view.camera.needs_aperture_sample else None
        return offset, position, aperture

    def render_pass(self, wavefront: Wavefront) -> None:
        """Adds the samples of a pass to the film."""
        offset, position, aperture = self.begin(wavefront)
        self.view.film.add(wavefront, offset, self.values(self.sampler, position, aperture))
        if not dr.flag(dr.JitFlag.FreezingScope):
            dr.sync_thread()

    def values(self, sampler: Any, position: Any, aperture: Any, active: Any = True) -> list[Any]:
        """The values of one sample a lane, in the order of ``names``: colour, then aovs."""
        settings, view, radiance = self.settings, self.view, self.radiance
        ray, differential = view.differentials.start(view.camera, position, aperture)
        how: dict[str, Any] = {"differentials": view.differentials, "differential": differential}
        random = self.texel_random(sampler)
        values: list[Any] = []
        if radiance is not None:
            values.extend(RADIANCE[radiance.kind](self.traced, radiance, sampler, ray, active, **how))
        if settings.kind == "aov":
            offsets = None if differential is not None else self.offset_rays(position, aperture)
            values = [*values, *aov(self.traced, settings, ray, offsets, active, random=random, **how)]
        return values

    def texel_random(self, sampler: Any) -> Any:
        """Random numbers (Array2f) with which aovs look up textures; None where they need none."""
        return sampler.next_2d() if self.settings.kind == "aov" and self.traced.draws_texels else None

    def offset_rays(self, position: Any, aperture: Any) -> tuple[Ray, Ray] | None:
        """Rays towards the next sample to the right and down, where aovs need them."""
        if not needs_offset_rays(self.settings):
            return None
        step, camera = self.view.step, self.view.camera
        right, down = type(position)(step[0], 0), type(position)(0, step[1])
        return camera.sample_ray(position + right, aperture), camera.sample_ray(position + down, aperture)
