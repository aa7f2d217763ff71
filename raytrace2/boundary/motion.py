"""What of the derivatives of a render is due to visibility that changes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import drjit as dr

from ..errors import SettingError
from ..job import Job
from ..live import Slot
from ..rays.wavefront import split_passes
from .crossings import Crossings
from .curves import Curves
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
        self._job = job
        self._samples = samples or job.view.film.pixel_count * job.sampler.sample_count
        places = {p for slot in slots for p in slot.places} & set(job.traced.store.with_derivatives())
        everything = range(len(geometry.surfaces))
        camera_moves = any(slot.holder is job.view.camera for slot in slots)
        moving = everything if camera_moves else job.traced.surfaces_of(places)
        self._seen = Curves.of(geometry, moving) if len(moving) else None

    def crossings(self, values: Sequence[Any]) -> Iterator[Crossings]:
        """The points, a pass at a time; ``values`` are what the slots hold."""
        job, seed = self._job, self._job.seed + 0x5BD1E995
        with dr.suspend_grad(values):
            choice = None if self._seen is None else view_choice(job, self._seen)
        for wavefront in split_passes(self._samples, 1, _LANES):
            if choice is not None:
                assert self._seen is not None
                with dr.suspend_grad(values):
                    found = silhouettes(
                        job, self._seen, choice, seed, wavefront.size, wavefront.first_pixel, self._samples
                    )
                yield found
