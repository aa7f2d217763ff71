"""Texture nodes, and properties that may be textures or constants."""

from __future__ import annotations

from typing import Any, Literal, cast

import numpy as np

from .description import BitmapTexture, CheckerboardTexture, ConstantTexture, FbmTexture, MeshAttributeTexture, Texture
from .nodes import Color, LiveObject, Node, SpectrumSamples
from .pixels import from_live, load_pixels, store_as_texture
from .reading import PropertyReader, Reading
from .spectra import Role, constant_rgb

_PLACEHOLDER = ConstantTexture((0.5, 0.5, 0.5))


def texture_property(properties: PropertyReader, name: str, role: Role = "reflectance") -> Texture:
    """The property ``name``: a nested texture, a number, a colour or a spectrum, or else its default."""
    node, reading = properties.node, properties.reading
    child = properties.child(name)
    if child is not None:
        if child.kind != "texture":
            reading.refuse(node, f"'{name}' must be a texture, not a {child.kind} ('{child.plugin}')")
            return _PLACEHOLDER
        return read_texture(child, reading, role)
    value = properties.raw(name)
    if value is None:
        return ConstantTexture(constant_rgb(properties.default(name), role), grey=True)
    try:
        return ConstantTexture(constant_rgb(value, role), role != "emission" and _is_one_number(value))
    except ValueError as error:
        reading.refuse(node, f"property '{name}': {error}")
        return _PLACEHOLDER


def constant_property(properties: PropertyReader, name: str, role: Role) -> ConstantTexture:
    """As :func:`texture_property` for what must not vary over a surface."""
    texture = texture_property(properties, name, role)
    if not isinstance(texture, ConstantTexture):
        properties.reading.refuse(properties.node, f"'{name}' must not vary in space", "give one colour")
        return ConstantTexture((1.0, 1.0, 1.0))
    return texture


def read_texture(node: Node, reading: Reading, role: Role) -> Texture:
    """The texture ``node``; a problem and a placeholder if it is not supported."""
    reader = _READERS.get(node.plugin)
    if reader is None:
        reading.unsupported(node, _READERS)
        return _PLACEHOLDER
    return cast(Texture, reading.once(node, lambda: reader(PropertyReader(node, reading), role)))


def to_uv(properties: PropertyReader) -> np.ndarray:
    """The 3x3 uv transform: the upper left 2x2 block and the translation of the 4x4 one, as Mitsuba takes it."""
    whole = properties.transform("to_uv", invertible=False)
    matrix = np.eye(3)
    matrix[:2, :2] = whole[:2, :2]
    matrix[:2, 2] = whole[:2, 3]
    return _frozen(matrix)


def _bitmap(properties: PropertyReader, role: Role) -> Texture:
    node, reading = properties.node, properties.reading
    filter_type = properties.choice("filter_type", ("bilinear", "nearest"))
    wrap_mode = properties.choice("wrap_mode", ("repeat", "mirror", "clamp"))
    raw = properties.boolean("raw")
    properties.ignore("accel")
    matrix = to_uv(properties)
    stated = properties.choice("format", ("auto", "variant", "float16", "fp16", "uint8"))
    given = [name for name in ("filename", "bitmap", "data") if properties.has(name)]
    live = properties.raw("bitmap") if "bitmap" in given else properties.raw("data")
    filename = properties.string("filename") if "filename" in given else ""
    properties.finish()
    if len(given) != 1:
        reading.refuse(node, "needs exactly one of 'filename', 'bitmap' and 'data'")
        return _PLACEHOLDER
    found: tuple[np.ndarray, bool] | None = None
    if filename:
        path = reading.file(node, filename)
        found = reading.attempt(node, lambda: load_pixels(path, raw, reading)) if path else None
    elif isinstance(live, LiveObject):
        found = reading.attempt(node, lambda: from_live(live.value))
    else:
        reading.refuse(node, f"property '{given[0]}' does not name an image")
    image, source_encoded = found if found else (None, False)
    stored = (
        None if image is None else reading.attempt(node, lambda: store_as_texture(image, source_encoded and not raw))
    )
    if stored is None:
        return _PLACEHOLDER
    pixels, encoded = stored
    kept = {"uint8": np.uint8, "float16": np.float16, "fp16": np.float16}.get(stated, pixels.dtype)
    if pixels.dtype != kept:
        reading.refuse(node, f"format '{stated}' would requantise this {pixels.dtype} image", "leave out 'format'")
    if pixels.dtype != np.uint8:
        least = -np.inf if raw or role == "unbounded" else 0.0
        if not np.isfinite(pixels).all():
            reading.refuse(node, f"{filename or given[0]}: has pixels that are not finite", "repair the image")
        elif float(pixels.min()) < least:
            reading.refuse(node, f"{filename or given[0]}: has negative pixels", "repair it, or set raw to true")
    return BitmapTexture(
        pixels=_frozen(pixels),
        filename=filename,
        filter_type=cast(Literal["nearest", "bilinear"], filter_type),
        wrap_mode=cast(Literal["repeat", "mirror", "clamp"], wrap_mode),
        # uint8 pixels count as encoded unless raw: a linear 8-bit image is a raw one
        raw=raw or (pixels.dtype == np.uint8 and not encoded),
        to_uv=matrix,
    )


def _checkerboard(properties: PropertyReader, role: Role) -> Texture:
    colors = [texture_property(properties, name) for name in ("color0", "color1")]
    matrix = to_uv(properties)
    properties.finish()
    return CheckerboardTexture(colors[0], colors[1], matrix)


def _mesh_attribute(properties: PropertyReader, role: Role) -> Texture:
    name = properties.string("name")
    scale = properties.number("scale")
    properties.finish()
    if not name.startswith(("vertex_", "face_")):
        properties.reading.refuse(properties.node, f"property 'name' must begin with vertex_ or face_, not {name!r}")
    return MeshAttributeTexture(name, scale)


def _fbm(properties: PropertyReader, role: Role) -> Texture:
    """Our own: see :class:`~.description.FbmTexture`, whose fields are its properties."""
    colors = []
    for name, grey in (("color0", 0.0), ("color1", 1.0)):
        given = properties.has(name)
        colors.append(constant_property(properties, name, role).value if given else (grey, grey, grey))
    texture = FbmTexture(
        colors[0],
        colors[1],
        properties.integer("octaves", least=1, most=32, default=8),
        properties.number("persistence", above=0.0, most=1.0, default=0.5),
        properties.number("lacunarity", least=1.0, most=16.0, default=2.0),
        properties.integer("seed", least=0, default=0),
        to_uv(properties),
    )
    properties.ignore("color0", "color1")
    properties.finish()
    return texture


def _uniform(properties: PropertyReader, role: Role) -> Texture:
    value = properties.number("value", least=0.0)
    properties.ignore("wavelength_min", "wavelength_max")
    properties.finish()
    return ConstantTexture(constant_rgb(value, role))


def _srgb(properties: PropertyReader, role: Role) -> Texture:
    unbounded = properties.raw("unbounded") is True
    return _constant(properties, "color", properties.raw("color"), "unbounded" if unbounded else "reflectance")


def _rawconstant(properties: PropertyReader, role: Role) -> Texture:
    value = properties.raw("value")
    if isinstance(value, np.ndarray):
        value = Color((float(value[0]), float(value[1]), float(value[2])))
    return _constant(properties, "value", value, "unbounded")


def _d65(properties: PropertyReader, role: Role) -> Texture:
    scale = properties.number("scale", least=0.0)
    color = properties.raw("color")
    if isinstance(color, Color):
        color = Color(tuple(c * scale for c in color.value))  # type: ignore[arg-type]
    return _constant(properties, "color", scale if color is None else color, "unbounded")


def _constant(properties: PropertyReader, name: str, value: Any, role: Role) -> Texture:
    properties.finish()
    try:
        return ConstantTexture(constant_rgb(value, role), _is_one_number(value))
    except ValueError as error:
        properties.reading.refuse(properties.node, f"property '{name}': {error}")
        return _PLACEHOLDER


def _is_one_number(value: Any) -> bool:
    return isinstance(value, int | float) or (isinstance(value, SpectrumSamples) and not value.wavelengths)


def _frozen(array: np.ndarray) -> np.ndarray:
    array = np.ascontiguousarray(array)
    array.setflags(write=False)
    return array


_READERS = {
    "bitmap": _bitmap,
    "checkerboard": _checkerboard,
    "mesh_attribute": _mesh_attribute,
    "raytrace2_fbm": _fbm,
    "uniform": _uniform,
    "srgb": _srgb,
    "rawconstant": _rawconstant,
    "d65": _d65,
}
