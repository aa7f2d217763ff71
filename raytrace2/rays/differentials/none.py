"""No differentials: rays are rays."""

from __future__ import annotations

from typing import Any

from ..ray import Ray
from .state import Meeting


class NoDifferentials:
    """Carries nothing and adds no operation to a kernel."""

    def start(self, camera: Any, position: Any, aperture: Any) -> tuple[Ray, None]:
        """The ray through a place on the film."""
        return camera.sample_ray(position, aperture), None

    def meet(self, structure: Any, ray: Ray, state: Any, hit: Any) -> Meeting:
        """The interaction, of unknown footprint."""
        si = structure.interact(ray, hit)
        return Meeting(si, si)

    def leave(self, meeting: Meeting, sample: Any, ray: Ray, state: Any) -> None:
        """Nothing."""


NO_DIFFERENTIALS = NoDifferentials()
