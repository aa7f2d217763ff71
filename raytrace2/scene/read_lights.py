"""Emitter nodes: lights of the scene, and the area lights that belong to shapes."""

from __future__ import annotations

import numpy as np

from .description import (
    AreaLight,
    BitmapTexture,
    CheckerboardTexture,
    ConstantLight,
    DirectionalLight,
    EnvironmentLight,
    Light,
    MeshAttributeTexture,
    PointLight,
    SpotLight,
)
from .nodes import LiveObject, Node
from .pixels import from_live, load_pixels, store_as_environment
from .read_textures import constant_property, texture_property
from .reading import PropertyReader, Reading


def read_light(node: Node, reading: Reading) -> Light | None:
    """The light ``node`` of the scene; None (and a problem) if it is not supported."""
    reader = _READERS.get(node.plugin)
    if reader is None:
        reading.unsupported(node, [*_READERS, "area (in a shape)"])
        return None
    properties = PropertyReader(node, reading)
    _weight(properties)
    return reader(properties)


def read_area_light(node: Node, reading: Reading) -> AreaLight | None:
    """The emitter inside a shape."""
    if node.plugin != "area":
        reading.unsupported(node, ["area"])
        return None
    if id(node) in reading.results:
        reading.refuse(node, "belongs to more than one shape", "write an area light of its own into each")
        return None
    properties = PropertyReader(node, reading)
    _weight(properties)
    light = AreaLight(texture_property(properties, "radiance", "emission"))
    properties.finish()
    reading.results[id(node)] = light
    return light


def _weight(properties: PropertyReader) -> None:
    if properties.number("sampling_weight") != 1.0:
        remedy = "leave it out: it changes the noise, not the image"
        properties.reading.refuse(properties.node, "'sampling_weight' other than 1 is not supported", remedy)


def _point(properties: PropertyReader) -> Light:
    position = properties.transform()[:3, 3]
    if properties.has("position"):
        if properties.has("to_world"):
            properties.reading.refuse(properties.node, "has both 'position' and 'to_world'", "keep one of them")
        position = properties.vector("position")
    color = constant_property(properties, "intensity", "emission")
    light = PointLight(_triple(position), color.value, color.grey)
    properties.finish()
    return light


def _spot(properties: PropertyReader) -> Light:
    cutoff = properties.number("cutoff_angle", above=0.0, most=180.0)
    beam = properties.number("beam_width", least=0.0, most=180.0, default=cutoff * 0.75)
    if not beam < cutoff:
        properties.reading.refuse(properties.node, f"'beam_width' {beam:g} must be below 'cutoff_angle' {cutoff:g}")
    texture = texture_property(properties, "texture") if properties.has("texture") else None
    if texture is not None and not isinstance(texture, BitmapTexture | CheckerboardTexture | MeshAttributeTexture):
        properties.reading.refuse(properties.node, "'texture' must vary in space", "multiply 'intensity' instead")
    if isinstance(texture, MeshAttributeTexture):
        properties.reading.refuse(properties.node, "'texture' cannot be a mesh attribute: a spot light has no mesh")
    if texture is not None and cutoff >= 90.0:
        properties.reading.refuse(properties.node, "a 'texture' needs a 'cutoff_angle' below 90 degrees")
    color = constant_property(properties, "intensity", "emission")
    light = SpotLight(frozen(properties.transform()), color.value, cutoff, beam, texture, color.grey)
    properties.finish()
    return light


def _directional(properties: PropertyReader) -> Light:
    direction = properties.transform()[:3, 2]
    if properties.has("direction"):
        if properties.has("to_world"):
            properties.reading.refuse(properties.node, "has both 'direction' and 'to_world'", "keep one of them")
        direction = properties.vector("direction")
    length = float(np.linalg.norm(direction))
    if not 0.0 < length < np.inf:
        properties.reading.refuse(properties.node, "'direction' must have a length")
        length = 1.0
    color = constant_property(properties, "irradiance", "emission")
    light = DirectionalLight(_triple(direction / length), color.value, color.grey)
    properties.finish()
    return light


def _constant(properties: PropertyReader) -> Light:
    color = constant_property(properties, "radiance", "emission")
    light = ConstantLight(color.value, color.grey)
    properties.ignore("to_world")
    properties.finish()
    return light


def _environment(properties: PropertyReader) -> Light | None:
    node, reading = properties.node, properties.reading
    scale = properties.number("scale", least=0.0)
    matrix = properties.transform()
    properties.boolean("mis_compensation")
    if has_scale(matrix):
        reading.refuse(node, "'to_world' must be a rotation or a reflection", "remove the scale")
    live = properties.raw("bitmap")
    given = [name for name in ("filename", "bitmap") if properties.has(name)]
    filename = properties.string("filename") if "filename" in given else ""
    properties.ignore("filename")
    properties.finish()
    if len(given) != 1:
        reading.refuse(node, "needs exactly one of 'filename' and 'bitmap'")
        return None
    if filename:
        path = reading.file(node, filename)
        found = reading.attempt(node, lambda: load_pixels(path, False, reading)) if path else None
    elif isinstance(live, LiveObject):
        found = reading.attempt(node, lambda: from_live(live.value))
    else:
        reading.refuse(node, f"property '{given[0]}' does not name an image")
        return None
    if found is None:
        return None
    pixels = reading.attempt(node, lambda: store_as_environment(*found))
    if pixels is None:
        return None
    if not np.isfinite(pixels).all():
        reading.refuse(node, f"{filename or 'bitmap'}: has pixels that are not finite", "repair the image")
    elif float(pixels.min()) < 0.0:
        reading.refuse(node, f"{filename or 'bitmap'}: has negative pixels", "repair the image")
    return EnvironmentLight(frozen(pixels), frozen(matrix), scale, filename)


def has_scale(matrix: np.ndarray) -> bool:
    """Whether the linear part is neither rotation nor reflection, with the tolerance (1e-3) of Mitsuba's cameras."""
    linear = matrix[:3, :3]
    return bool(np.abs(linear @ linear.T - np.eye(3)).max() > 1e-3)


def frozen(array: np.ndarray) -> np.ndarray:
    """``array``, contiguous and read-only."""
    array = np.ascontiguousarray(array)
    array.setflags(write=False)
    return array


def _triple(vector: np.ndarray) -> tuple[float, float, float]:
    return (float(vector[0]), float(vector[1]), float(vector[2]))


_READERS = {
    "point": _point,
    "spot": _spot,
    "directional": _directional,
    "constant": _constant,
    "envmap": _environment,
}
