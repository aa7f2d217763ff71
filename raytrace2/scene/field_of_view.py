"""The field of view along one axis of an image from that along another."""

from __future__ import annotations

import math


def x_fov_of(fov: float, axis: str, aspect: float) -> float:
    """The horizontal field of view, in degrees, of an image of ``aspect`` (width over height) whose field of view along
    ``axis`` (``x``, ``y``, ``diagonal``, ``smaller`` or ``larger``) is ``fov`` degrees."""
    return _scaled(fov, 1.0 / _share(axis, aspect))


def fov_along(x_fov: float, axis: str, aspect: float) -> float:
    """The field of view along ``axis`` of an image whose horizontal one is ``x_fov``: the inverse of
    :func:`x_fov_of`."""
    return _scaled(x_fov, _share(axis, aspect))


def _share(axis: str, aspect: float) -> float:
    """The length of the image along ``axis`` over its width."""
    if axis == "diagonal":
        return math.hypot(1.0, 1.0 / aspect)
    if axis in ("smaller", "larger"):
        axis = "y" if (aspect > 1.0) == (axis == "smaller") else "x"
    return 1.0 / aspect if axis == "y" else 1.0


def _scaled(fov: float, factor: float) -> float:
    return fov if factor == 1.0 else math.degrees(2.0 * math.atan(math.tan(0.5 * math.radians(fov)) * factor))
