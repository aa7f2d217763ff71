"""The way back from points of the world to the film, along the rays of a camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from .orthographic import Orthographic
from .perspective import Perspective
from .thin_lens import ThinLens


@dataclass(frozen=True, eq=False)
class FilmMap:
    """Where on the film a point is seen (film positions in [0, 1]^2 of the crop window, from the top left).

    ``eye`` (Array3f) is where all rays come from or, if they are ``parallel``, the direction back along them. With
    ``x`` as seen from ``base`` the position is ``(across . x, down . x) / depth``, where ``depth`` is ``along . x``, or
    1 if ``parallel``. ``du`` and ``dv`` are the steps that positions make in the world at depth 1. Differentiable in
    the camera.
    """

    base: Any
    across: Any
    down: Any
    along: Any
    du: Any
    dv: Any
    eye: Any
    parallel: bool

    @staticmethod
    def of(camera: Any, aperture_sample: Any = None) -> FilmMap:
        """The map of ``camera``, for one point of its lens a lane (``aperture_sample``) if it has one."""
        if isinstance(camera, Orthographic):
            corner, du, dv, direction = camera.axes
            return FilmMap._of(corner, du, dv, direction, -direction, True)
        assert isinstance(camera, Perspective | ThinLens)
        origin, corner, du, dv = camera.pinhole(aperture_sample)
        return FilmMap._of(origin, du, dv, corner, origin, False)

    @staticmethod
    def _of(base: Any, du: Any, dv: Any, third: Any, eye: Any, parallel: bool) -> FilmMap:
        # The basis dual to du, dv and the way along the rays.
        across, down, along = dr.cross(dv, third), dr.cross(third, du), dr.cross(du, dv)
        inverse = 1 / dr.dot(du, across)
        return FilmMap(base, across * inverse, down * inverse, along * inverse, du, dv, eye, parallel)

    def weights(self, x: Any) -> tuple[Any, Any, Any]:
        """Homogeneous coordinates of the film positions of the points ``x``: two, and the depth that divides them."""
        way = x - self.base
        depth = type(way.x)(1) if self.parallel else dr.dot(self.along, way)
        return dr.dot(self.across, way), dr.dot(self.down, way), depth

    def position(self, x: Any) -> Any:
        """Film positions (two Floats) of the points ``x``, which must not have depth 0."""
        u, v, depth = self.weights(x)
        return u / depth, v / depth

    def tangent(self, x: Any, dx: Any) -> tuple[Any, Any]:
        """How :meth:`position` changes where ``x`` changes by ``dx``."""
        u, v, depth = self.weights(x)
        du, dv = dr.dot(self.across, dx), dr.dot(self.down, dx)
        if self.parallel:
            return du, dv
        change, inverse = dr.dot(self.along, dx), 1 / depth
        return (du - u * inverse * change) * inverse, (dv - v * inverse * change) * inverse
