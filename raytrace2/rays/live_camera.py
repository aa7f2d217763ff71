"""How a camera follows from a transform, a field of view, ... that may change."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr

from ..live import Live, Place, Slot, Values
from ..scene.description import Camera, OrthographicCamera, PerspectiveCamera, ThinLensCamera
from ..types import types

_FIELDS = ("to_world", "x_fov", "principal_point_offset_x", "principal_point_offset_y", "aperture_radius")


def camera_slots(camera: Any, now: Camera, original: Camera, live: Live, fov_scale: float = 1.0) -> list[Slot]:
    """The slots of ``camera``, made of the description ``now``, which was ``original`` when the scene was loaded.

    ``fov_scale``: by how much the tangent of half the angle of view is larger than that of the parameter, because the
    film has another shape.
    """
    found: list[Slot] = []
    places = {field: p for field in _FIELDS if (p := live.place(original, field)) is not None}
    if places:
        view = _View(now, places, fov_scale)
        found.append(Slot.of(camera, "_axes", places.values(), view.axes, moves=True))
    focus = live.place(original, "focus_distance")
    if focus is not None:
        found.append(Slot.of(camera, "_power", [focus], lambda base, values: type(base)(1 / values(focus)), moves=True))
    return found


class _View:
    """The vectors of a camera, computed in float64, as those of cameras that stay are."""

    def __init__(self, camera: Camera, places: dict[str, Place], fov_scale: float) -> None:
        self._camera, self._places, self._fov_scale = camera, places, fov_scale

    def axes(self, base: list[Any], values: Values) -> list[Any]:
        """What ``base`` is for other values."""
        Float = types("float64").Float
        camera, film = self._camera, self._camera.film

        def number(field: str, fixed: float) -> Any:
            return Float(values(self._places[field])) if field in self._places else fixed

        if "to_world" in self._places:
            matrix = values(self._places["to_world"])
            rows = [[Float(matrix[i, j]) for j in range(4)] for i in range(3)]
        else:
            rows = [[Float(float(camera.to_world[i, j])) for j in range(4)] for i in range(3)]
        x, y, z, origin = ([row[k] for row in rows] for k in range(4))
        aspect = film.width / film.height
        size: Any = 1.0
        shift_x: Any = 0.0
        shift_y: Any = 0.0
        if isinstance(camera, PerspectiveCamera):
            if "x_fov" in self._places:
                size = dr.tan(number("x_fov", 0.0) * (math.pi / 360)) * self._fov_scale
            else:
                size = math.tan(math.radians(camera.x_fov) / 2)
            shift_x = number("principal_point_offset_x", camera.principal_point_offset_x)
            shift_y = number("principal_point_offset_y", camera.principal_point_offset_y)
        left = size * (1 - 2 * (film.crop_offset_x / film.width + shift_x))
        top = size * (1 - 2 * (film.crop_offset_y / film.height + shift_y)) / aspect
        across = size * (-2 * film.crop_width / film.width)
        down = size * (-2 * film.crop_height / film.height) / aspect
        depth = camera.near_clip if isinstance(camera, OrthographicCamera) else 1.0
        corner = [a * left + b * top + c * depth for a, b, c in zip(x, y, z, strict=True)]
        du, dv = [a * across for a in x], [b * down for b in y]
        if isinstance(camera, OrthographicCamera):
            corner = [c + o for c, o in zip(corner, origin, strict=True)]
            length = dr.sqrt(z[0] * z[0] + z[1] * z[1] + z[2] * z[2])
            vectors = [corner, du, dv, [c / length for c in z]]
        else:
            vectors = [corner, du, dv, origin]
        if isinstance(camera, ThinLensCamera):
            radius = number("aperture_radius", camera.aperture_radius)
            vectors += [[a * radius for a in x], [b * radius for b in y]]
        vector = type(base[0])
        narrow = type(base[0].x)
        return [vector(*(narrow(c) for c in v)) for v in vectors]
