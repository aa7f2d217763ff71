"""Sensor nodes."""

from __future__ import annotations

import math
from typing import Any

from .description import Camera, Film, OrthographicCamera, PerspectiveCamera, ThinLensCamera
from .field_of_view import x_fov_of
from .nodes import Node
from .read_film import read_film, read_sampler
from .read_lights import frozen, has_scale
from .reading import PropertyReader, Reading

_CAMERAS = ("perspective", "thinlens", "orthographic")
_FOV_AXES = ("x", "y", "diagonal", "smaller", "larger")


def read_camera(node: Node, reading: Reading) -> Camera | None:
    """The camera ``node``; None (and a problem) if it is not supported."""
    if node.plugin not in _CAMERAS:
        reading.unsupported(node, _CAMERAS)
        return None
    properties = PropertyReader(node, reading)
    film = read_film(properties.only_child("film"), reading)
    near, far = properties.number("near_clip", above=0.0), properties.number("far_clip", above=0.0)
    if not near < far:
        reading.refuse(node, f"'near_clip' {near:g} must be below 'far_clip' {far:g}")
    matrix = properties.transform()
    common: dict[str, Any] = {
        "to_world": frozen(matrix),
        "near_clip": near,
        "far_clip": far,
        "film": film,
        "sampler": read_sampler(properties.only_child("sampler"), reading),
        "id": node.id,
    }
    # Nothing moves, so that the time at which the shutter is open shapes nothing
    shutter_open = properties.number("shutter_open", default=0.0)
    if properties.number("shutter_close", default=shutter_open) < shutter_open:
        reading.refuse(node, "'shutter_close' must not lie before 'shutter_open'")
    focus = properties.number("focus_distance", above=0.0, default=far)
    if node.plugin == "orthographic":
        properties.finish()
        return OrthographicCamera(**common)
    if has_scale(matrix):
        reading.refuse(node, "'to_world' must not scale", "remove the scale; use the field of view to see more or less")
    common["x_fov"], common["fov_axis"] = _x_fov(properties, film)
    camera: Camera
    if node.plugin == "thinlens":
        camera = ThinLensCamera(
            aperture_radius=properties.number("aperture_radius", above=0.0), focus_distance=focus, **common
        )
    else:
        camera = PerspectiveCamera(
            principal_point_offset_x=properties.number("principal_point_offset_x"),
            principal_point_offset_y=properties.number("principal_point_offset_y"),
            **common,
        )
    properties.finish()
    return camera


def _x_fov(properties: PropertyReader, film: Film) -> tuple[float, str]:
    """The horizontal field of view in degrees, as Mitsuba derives it from what is given, and the axis that it was
    given for."""
    node, reading = properties.node, properties.reading
    axis = properties.choice("fov_axis", _FOV_AXES, fold=True)
    if properties.has("fov") and properties.has("focal_length"):
        reading.refuse(node, "has both 'fov' and 'focal_length'", "keep one of them")
    if properties.has("fov"):
        fov = properties.number("fov")
        if not 0.0 < fov < 180.0:
            reading.refuse(node, f"'fov' must be between 0 and 180 degrees, not {fov:g}")
            return 45.0, axis
        properties.ignore("focal_length")
    else:
        length = _focal_length(properties)
        # The diagonal of 35 mm film
        fov, axis = 2.0 * math.degrees(math.atan(math.hypot(36.0, 24.0) / (2.0 * length))), "diagonal"
    return x_fov_of(fov, axis, film.width / film.height), axis


def _focal_length(properties: PropertyReader) -> float:
    text = properties.string("focal_length")
    try:
        length = float(text.removesuffix("mm"))
    except ValueError:
        length = math.nan
    if not 0.0 < length < math.inf:
        properties.reading.refuse(properties.node, f'\'focal_length\' must be like "50mm", not "{text}"')
        return 50.0
    return length
