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
from .choose import Choice
from .crossings import Crossings
from .curves import Curves
from .gathered_edges import Gathering, gathered_edges, gathers
from .light_points import LightKind
from .shadow_edges import Casting, casts, shadow_edges
from .silhouettes import silhouettes, view_choice

#: Samples of a pass.
_LANES = 1 << 20


class Boundary:
    """The moving edges in the image of ``job``, by ``samples`` points of them (0: as many as the image has samples),
    where the values of ``slots`` carry derivatives. ``SettingError`` for scenes that have instances."""

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
        self._job, self._light = job, light or job
        self._samples = samples or job.view.film.pixel_count * job.sampler.sample_count
        places = {p for slot in slots for p in slot.places} & set(job.traced.store.with_derivatives())
        surfaces = range(len(geometry.surfaces))
        everywhere = any(slot.holder is job.view.camera for slot in slots)
        moving = surfaces if everywhere else job.traced.surfaces_of(places)
        lights_move = any(slot.moves and any(slot is x for x in job.traced.lights.slots) for slot in slots)
        self._seen = Curves.of(geometry, moving) if len(moving) else None
        self._casting = list(self._castings(moving, lights_move)) if light is not None and casts(light) else []
        self._gathering = list(self._groups(moving, False)) if light is not None and gathers(light) else []

    def crossings(self, values: Sequence[Any]) -> Iterator[Crossings]:
        """The points, a pass at a time; ``values`` are what the slots hold."""
        job, light, seed = self._job, self._light, self._job.seed
        if self._seen is not None:
            seen = self._seen
            with dr.suspend_grad(values):
                choice = view_choice(job, seen)
            yield from self._passes(values, lambda *which: silhouettes(job, seen, choice, seed + 0x5BD1E995, *which))
        for k, (kind, curves, receives) in enumerate(self._casting):
            with dr.suspend_grad(values):
                casting = Casting(kind, curves, Choice(curves.lengths(), job.traced.types), receives)
            yield from self._passes(
                values, lambda *which, c=casting, k=k: shadow_edges(light, c, seed + 0x1B873593 + k, *which)
            )
        for k, (curves, receives) in enumerate(self._gathering):
            with dr.suspend_grad(values):
                gathering = Gathering(curves, Choice(curves.lengths(), job.traced.types), receives)
            yield from self._passes(
                values, lambda *which, g=gathering, k=k: gathered_edges(light, g, seed + 0x4CF5AD43 + k, *which)
            )

    def _passes(self, values: Sequence[Any], sample: Callable[[int, int, int], Crossings]) -> Iterator[Crossings]:
        for wavefront in split_passes(self._samples, 1, _LANES):
            with dr.suspend_grad(values):
                found = sample(wavefront.size, wavefront.first_pixel, self._samples)
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
