"""Runtime cameras from their descriptions."""

from __future__ import annotations

from typing import Any, Protocol

from ..scene.description import Camera as CameraDescription
from ..scene.description import OrthographicCamera, PerspectiveCamera, ThinLensCamera
from ..types import Types
from .film_plane import camera_error
from .orthographic import Orthographic
from .perspective import Perspective
from .ray import Ray
from .thin_lens import ThinLens


class Camera(Protocol):
    """Anything that turns film positions into rays."""

    needs_aperture_sample: bool

    def sample_ray(self, film_position: Any, aperture_sample: Any = None) -> Ray:
        """Rays of unit direction through film positions in [0, 1]^2 of the crop window, from the top left."""

    def sample_ray_differential(
        self, film_position: Any, aperture_sample: Any, step: tuple[Any, Any]
    ) -> tuple[Ray, tuple[Any, Any], tuple[Any, Any]]:
        """The same, and how origin and direction change for ``step`` to the right and down on the film."""


def make_camera(desc: CameraDescription, types: Types) -> Camera:
    """The camera of ``desc`` in the precision of ``types``, with Mitsuba's conventions.

    Its parameters lie in device buffers, so that kernels are reused when the camera moves. :class:`SceneError` for a
    camera that cannot be built (scaled ``to_world``, no field of view, empty clip range).
    """
    if isinstance(desc, ThinLensCamera):
        return ThinLens(desc, types)
    if isinstance(desc, PerspectiveCamera):
        return Perspective(desc, types)
    if isinstance(desc, OrthographicCamera):
        return Orthographic(desc, types)
    raise camera_error(desc, f"no camera for {type(desc).__name__}", "use perspective, thinlens or orthographic")
