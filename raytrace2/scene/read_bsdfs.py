"""BSDF nodes."""

from __future__ import annotations

from typing import cast

from .defaults import IOR
from .description import (
    Bsdf,
    ConductorBsdf,
    ConstantTexture,
    DielectricBsdf,
    DiffuseBsdf,
    MaskBsdf,
    ThinDielectricBsdf,
    TwoSidedBsdf,
)
from .nodes import Node
from .read_textures import texture_property
from .reading import PropertyReader, Reading
from .spectra import conductor_rgb

_DEEPEST = 32


def read_bsdf(node: Node, reading: Reading, depth: int = 0) -> Bsdf:
    """The BSDF ``node``; a problem and a placeholder if it is not supported."""
    reader = _READERS.get(node.plugin)
    if reader is None:
        reading.unsupported(node, _READERS)
        for _, child in node.children:
            if child.kind == "bsdf" and depth < _DEEPEST:
                read_bsdf(child, reading, depth + 1)
        return DiffuseBsdf()
    if depth > _DEEPEST:
        reading.refuse(node, f"BSDFs are nested more than {_DEEPEST} deep", "flatten them")
        return DiffuseBsdf()
    return cast(Bsdf, reading.once(node, lambda: reader(PropertyReader(node, reading), depth)))


def _diffuse(properties: PropertyReader, depth: int) -> Bsdf:
    bsdf = DiffuseBsdf(texture_property(properties, "reflectance"))
    properties.finish()
    return bsdf


def _conductor(properties: PropertyReader, depth: int) -> Bsdf:
    material = properties.string("material")
    explicit = [name for name in ("eta", "k") if properties.has(name)]
    eta = texture_property(properties, "eta", "unbounded")
    k = texture_property(properties, "k", "unbounded")
    reflectance = texture_property(properties, "specular_reflectance")
    properties.finish()
    if material != "none":
        if explicit:
            properties.reading.refuse(properties.node, "has both 'material' and eta/k", "keep one of them")
        try:
            eta, k = (ConstantTexture(rgb) for rgb in conductor_rgb(material))
        except ValueError as error:
            properties.reading.refuse(properties.node, str(error))
    return ConductorBsdf(eta, k, reflectance)


def _dielectric(properties: PropertyReader, depth: int) -> Bsdf:
    kind = ThinDielectricBsdf if properties.node.plugin == "thindielectric" else DielectricBsdf
    bsdf = kind(
        _index_of_refraction(properties, "int_ior"),
        _index_of_refraction(properties, "ext_ior"),
        texture_property(properties, "specular_reflectance"),
        texture_property(properties, "specular_transmittance"),
    )
    properties.finish()
    return bsdf


def _index_of_refraction(properties: PropertyReader, name: str) -> float:
    if not isinstance(properties.node.properties.get(name, ""), str):
        return properties.number(name, above=0.0)
    material = properties.string(name).lower()
    if material not in IOR:
        properties.reading.refuse(
            properties.node, f"the material '{material}' of '{name}' is unknown", f"known are: {', '.join(IOR)}"
        )
    return IOR.get(material, 1.0)


def _two_sided(properties: PropertyReader, depth: int) -> Bsdf:
    sides = properties.children("bsdf")
    transmission = properties.boolean("allow_transmission")
    properties.finish()
    if len(sides) not in (1, 2):
        properties.reading.refuse(properties.node, f"needs one or two nested BSDFs, not {len(sides)}")
        return DiffuseBsdf()
    bsdfs = [read_bsdf(child, properties.reading, depth + 1) for _, child in sides]
    if any(_transmits(bsdf) for bsdf in bsdfs):
        remedy = "leave out the twosided: a dielectric or a mask has two sides by itself"
        flag = " with allow_transmission" if transmission else ""
        properties.reading.refuse(properties.node, f"cannot hold a BSDF that transmits light{flag}", remedy)
    return TwoSidedBsdf(bsdfs[0], bsdfs[-1])


def _mask(properties: PropertyReader, depth: int) -> Bsdf:
    opacity = texture_property(properties, "opacity")
    nested = properties.only_child("bsdf", required=True)
    properties.finish()
    return MaskBsdf(read_bsdf(nested, properties.reading, depth + 1) if nested else DiffuseBsdf(), opacity)


def _transmits(bsdf: Bsdf) -> bool:
    # What a twosided holds has been checked when it was read
    return isinstance(bsdf, DielectricBsdf | ThinDielectricBsdf | MaskBsdf)


_READERS = {
    "diffuse": _diffuse,
    "conductor": _conductor,
    "dielectric": _dielectric,
    "thindielectric": _dielectric,
    "twosided": _two_sided,
    "mask": _mask,
}
