"""What cameras hold: film, reconstruction filter and sampler."""

from __future__ import annotations

from typing import Literal, TypeAlias, cast

from .description import Film, ReconstructionFilter, Sampler
from .nodes import Node
from .reading import PropertyReader, Reading

Kind: TypeAlias = Literal["independent", "stratified", "ldsampler", "multijitter"]

_FILTERS = ("box", "tent", "gaussian", "mitchell", "catmullrom", "lanczos")
_SAMPLERS = ("independent", "stratified", "multijitter", "ldsampler")
_LARGEST_SIDE = 1 << 20


def read_film(node: Node | None, reading: Reading) -> Film:
    """The film ``node``, or the one that Mitsuba makes where there is none."""
    if node is None:
        return Film()
    if node.plugin != "hdrfilm":
        reading.unsupported(node, ["hdrfilm"])
        return Film()
    properties = PropertyReader(node, reading)
    width = properties.integer("width", least=1, most=_LARGEST_SIDE)
    height = properties.integer("height", least=1, most=_LARGEST_SIDE)
    crop_width = properties.integer("crop_width", least=1, default=width)
    crop_height = properties.integer("crop_height", least=1, default=height)
    x = properties.integer("crop_offset_x", least=0)
    y = properties.integer("crop_offset_y", least=0)
    if x + crop_width > width or y + crop_height > height:
        message = f"the crop window ({x}, {y}) + {crop_width} x {crop_height} leaves the film of {width} x {height}"
        reading.refuse(node, message)
    filter_node = properties.only_child("rfilter")
    pixel_format = properties.string("pixel_format").lower()
    if pixel_format not in ("rgb", "luminance"):
        reading.refuse(node, f"pixel_format '{pixel_format}' is not supported", "supported are: rgb, luminance")
    sample_border = properties.boolean("sample_border")
    # How a file would be written; renders are handed over as arrays
    properties.choice("file_format", ("openexr", "exr", "rgbe", "pfm"), fold=True)
    properties.choice("component_format", ("float16", "float32", "uint32"), fold=True)
    properties.ignore("banner", "compensate")
    properties.finish()
    rfilter = _read_filter(filter_node, reading)
    return Film(width, height, x, y, crop_width, crop_height, rfilter, pixel_format, sample_border)


def _read_filter(node: Node | None, reading: Reading) -> ReconstructionFilter:
    if node is None:
        return ReconstructionFilter()
    if node.plugin not in _FILTERS:
        reading.unsupported(node, _FILTERS)
        return ReconstructionFilter()
    properties = PropertyReader(node, reading)
    match node.plugin:
        case "box":
            rfilter = ReconstructionFilter("box", radius=0.5)
        case "tent":
            rfilter = ReconstructionFilter("tent", radius=properties.number("radius", above=0.0, most=64.0))
        case "gaussian":
            rfilter = ReconstructionFilter("gaussian", stddev=properties.number("stddev", above=0.0, most=16.0))
        case "mitchell":
            rfilter = ReconstructionFilter("mitchell", B=properties.number("B"), C=properties.number("C"))
        case "lanczos":
            rfilter = ReconstructionFilter("lanczos", lobes=properties.integer("lobes", least=1, most=64))
        case _:
            rfilter = ReconstructionFilter("catmullrom")
    properties.finish()
    return rfilter


def read_sampler(node: Node | None, reading: Reading) -> Sampler:
    """The sampler ``node``, or the one that Mitsuba makes where there is none. ``sample_count`` is not yet rounded."""
    if node is None:
        return Sampler()
    if node.plugin not in _SAMPLERS:
        reading.unsupported(node, _SAMPLERS)
        return Sampler()
    properties = PropertyReader(node, reading)
    count = properties.integer("sample_count", least=1)
    seed = properties.integer("seed", least=0, most=2**32 - 1)
    jitter = properties.boolean("jitter") if node.plugin in ("stratified", "multijitter") else True
    properties.finish()
    return Sampler(cast(Kind, node.plugin), count, seed, jitter)
