"""What of the derivatives of a render is due to visibility that changes."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..errors import SettingError
from ..job import Job
from ..live import Slot
from ..rays.wavefront import split_passes
from .casting import Casting, casts
from .choose import Choice
from .crossings import Crossings
from .curves import Curves
from .gathered_edges import Gathering, gathered_edges, gathers
from .light_points import LightKind
from .scattered_shadows import scattered_shadows
from .shadow_edges import shadow_edges
from .silhouettes import silhouettes, view_choice

#: Samples of a pass.
_LANES = 1 << 20
#: The longest paths whose edges are looked for have so many surfaces that scatter light.
_BOUNCES = 6


class Boundary:
    """The moving edges in the image of ``job``, where the values of ``slots`` carry derivatives. ``SettingError`` for
    scenes that have instances.

    ``samples`` (0: as many as the image has) points are taken of edges on the film, of those in the shadows of each
    group of curves by each kind of light, and of those that each group gives to gathered light: half as many for each
    time that the light is scattered on.
    """

    def __init__(self, job: Job, slots: Sequence[Slot], samples: int) -> None:
        geometry = job.traced.structure.geometry
        if geometry.instances:
            raise SettingError(
                "the edges of instances have no derivatives: render with visibility_gradients=False, or write the "
                "shapes of the group out in the scene"
            )
        light = job.of_light
        if light is not None and job.traced.materials.has_delta:
            warnings.warn(
                "edges that are seen in mirrors or through glass, and shadows seen through masks, have no derivatives",
                RuntimeWarning,
                stacklevel=4,
            )
        self._job, self._light = job, light
        self._samples = samples or job.view.film.pixel_count * job.sampler.sample_count
        self._everything = range(len(geometry.surfaces))
        places = {p for slot in slots for p in slot.places} & set(job.traced.store.with_derivatives())
        everywhere = any(slot.holder is job.view.camera for slot in slots)
        moving = self._everything if everywhere else job.traced.surfaces_of(places)
        lights_move = any(slot.moves and any(slot is x for x in job.traced.lights.slots) for slot in slots)
        self._seen = Curves.of(geometry, moving) if len(moving) else None
        self._casting = list(self._castings(moving, lights_move)) if light is not None else []
        self._gathering = list(self._groups(moving, False)) if light is not None else []

    def crossings(self, values: Sequence[Any]) -> Iterator[Crossings]:
        """The points, a pass at a time; ``values`` are what the slots hold."""
        job, seed = self._job, self._job.seed
        if self._seen is not None:
            seen = self._seen
            with dr.suspend_grad(values):
                choice = view_choice(job, seen)
            yield from self._passes(values, lambda *which: silhouettes(job, seen, choice, seed + 0x5BD1E995, *which))
        for bounces in range(_BOUNCES):
            yield from self._shadows(values, bounces)
            yield from self._gathered(values, bounces)

    def _shadows(self, values: Sequence[Any], bounces: int) -> Iterator[Crossings]:
        """Those of light found by sampling lights, on surfaces so many ``bounces`` from what the camera sees."""
        job, seed = self._light, self._job.seed
        if job is None or not casts(job, bounces):
            return
        # Paths move with all that they meet, and so does what is seen from where they get to.
        castings = self._castings(self._everything, True) if bounces else self._casting
        for k, (kind, curves, receives) in enumerate(castings):
            with dr.suspend_grad(values):
                casting = Casting(kind, curves, Choice(curves.lengths(), job.traced.types), receives)

            def sample(*which: int, casting: Casting = casting, seed: Any = seed + 0x1B873593 + k) -> Crossings:
                if bounces == 0:
                    return shadow_edges(job, casting, seed, *which)
                return scattered_shadows(job, casting, bounces - 1, seed + 0x3C6EF372 * bounces, *which)

            yield from self._passes(values, sample, bounces)

    def _gathered(self, values: Sequence[Any], bounces: int) -> Iterator[Crossings]:
        """Those of light found by sampling materials, likewise."""
        job, seed = self._light, self._job.seed
        if job is None or not gathers(job, bounces):
            return
        groups = self._groups(self._everything, True) if bounces else self._gathering
        for k, (curves, receives) in enumerate(groups):
            with dr.suspend_grad(values):
                gathering = Gathering(curves, Choice(curves.lengths(), job.traced.types), receives)

            def sample(*which: int, gathering: Gathering = gathering, seed: Any = seed + 0x4CF5AD43 + k) -> Crossings:
                return gathered_edges(job, gathering, bounces, seed + 0x3C6EF372 * bounces, *which)

            yield from self._passes(values, sample, bounces)

    def _passes(self, values: Sequence[Any], sample: Callable[..., Crossings], bounces: int = 0) -> Iterator[Crossings]:
        # Less light comes from farther on.
        total = max(self._samples >> bounces, 1)
        for wavefront in split_passes(total, 1, _LANES):
            with dr.suspend_grad(values):
                found = sample(wavefront.size, wavefront.first_pixel, total)
            yield found

    def _castings(self, moving: Sequence[int], lights_move: bool) -> Iterator[tuple[LightKind, Curves, Any]]:
        """What casts shadows of which lights on what."""
        for kind in LightKind.all(self._job.traced):
            for curves, receives in self._groups(moving, lights_move):
                yield kind, curves, receives

    def _groups(self, moving: Sequence[int], lights_move: bool) -> Iterator[tuple[Curves, Any]]:
        """What is seen from what: where neither is among the surfaces that move, edges move only with lights and the
        camera."""
        scene = self._job.traced
        geometry = scene.structure.geometry
        count = len(geometry.surfaces)
        groups: list[tuple[list[int], Any]] = [(list(range(count)), None)]
        if not lights_move:
            flags = np.zeros(count, np.uint32)
            flags[list(moving)] = 1
            mask = owned(flags, scene.types.UInt)
            others = [k for k in range(count) if not flags[k]] if len(moving) else []
            groups = [(list(moving), None), (others, mask)]
        for surfaces, receives in groups:
            curves = Curves.of(geometry, surfaces) if surfaces else None
            if curves is not None:
                yield curves, receives
