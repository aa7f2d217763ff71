"""BSDF nodes."""

from __future__ import annotations

from typing import Any, Literal, cast

from .defaults import IOR
from .description import (
    BitmapTexture,
    Bsdf,
    BumpMapBsdf,
    ConductorBsdf,
    ConstantTexture,
    DielectricBsdf,
    DiffuseBsdf,
    MaskBsdf,
    NormalMapBsdf,
    RoughConductorBsdf,
    Texture,
    ThinDielectricBsdf,
    TwoSidedBsdf,
)
from .nodes import Node
from .read_textures import read_texture, texture_property
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
    eta, k, reflectance = _complex_index(properties)
    properties.finish()
    return ConductorBsdf(eta, k, reflectance)


def _rough_conductor(properties: PropertyReader, depth: int) -> Bsdf:
    eta, k, reflectance = _complex_index(properties)
    distribution = properties.choice("distribution", ("beckmann", "ggx"), fold=True)
    visible = properties.boolean("sample_visible")
    axes = [name for name in ("alpha_u", "alpha_v") if properties.has(name)]
    if len(axes) == 1 or (axes and properties.has("alpha")):
        properties.reading.refuse(properties.node, "has a part of 'alpha', 'alpha_u' and 'alpha_v'",
                                  "give 'alpha' alone, or both 'alpha_u' and 'alpha_v'")  # fmt: skip
    names = ("alpha_u", "alpha_v") if len(axes) == 2 else ("alpha", "alpha")
    alpha_u = texture_property(properties, names[0], "unbounded")
    alpha_v = texture_property(properties, names[1], "unbounded") if len(axes) == 2 else alpha_u
    properties.ignore("alpha", "alpha_u", "alpha_v")
    properties.finish()
    kind = cast(Literal["beckmann", "ggx"], distribution)
    return RoughConductorBsdf(kind, alpha_u, alpha_v, visible, eta, k, reflectance)


def _complex_index(properties: PropertyReader) -> tuple[Texture, Texture, Texture]:
    """``eta``, ``k`` and ``specular_reflectance`` of a conductor."""
    material = properties.string("material")
    explicit = [name for name in ("eta", "k") if properties.has(name)]
    eta = texture_property(properties, "eta", "unbounded")
    k = texture_property(properties, "k", "unbounded")
    reflectance = texture_property(properties, "specular_reflectance")
    if material != "none":
        if explicit:
            properties.reading.refuse(properties.node, "has both 'material' and eta/k", "keep one of them")
        try:
            eta, k = (ConstantTexture(rgb) for rgb in conductor_rgb(material))
        except ValueError as error:
            properties.reading.refuse(properties.node, str(error))
    return eta, k, reflectance


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


def _bump_map(properties: PropertyReader, depth: int) -> Bsdf:
    node, reading = properties.node, properties.reading
    scale = properties.number("scale")
    flip, shadow = properties.boolean("flip_invalid_normals"), properties.boolean("use_shadowing_function")
    child = properties.only_child("texture", required=True)
    nested = _below_map(properties, depth)
    texture = read_texture(child, reading, "unbounded") if child else ConstantTexture((0.0, 0.0, 0.0))
    if not isinstance(texture, BitmapTexture | ConstantTexture):
        reading.refuse(node, f"a {child.plugin if child else ''} has no gradient", "use a bitmap")
    return BumpMapBsdf(nested, texture, scale, flip, shadow)


def _normal_map(properties: PropertyReader, depth: int) -> Bsdf:
    node, reading = properties.node, properties.reading
    flip, shadow = properties.boolean("flip_invalid_normals"), properties.boolean("use_shadowing_function")
    child = properties.child("normalmap")
    nested = _below_map(properties, depth)
    texture = read_texture(child, reading, "unbounded") if child and child.kind == "texture" else None
    if not (isinstance(texture, BitmapTexture) and texture.pixels.shape[2] == 3):
        reading.refuse(node, "'normalmap' must be a bitmap of three channels", "encode normals as (n + 1) / 2")
        return nested
    return NormalMapBsdf(nested, texture, flip, shadow)


def _below_map(properties: PropertyReader, depth: int) -> Bsdf:
    child = properties.only_child("bsdf", required=True)
    properties.finish()
    nested = read_bsdf(child, properties.reading, depth + 1) if child else DiffuseBsdf()
    if _holds(nested, MaskBsdf):
        properties.reading.refuse(properties.node, "cannot hold a mask", "put the mask around it")
    if _holds(nested, BumpMapBsdf | NormalMapBsdf):
        properties.reading.refuse(properties.node, "cannot hold another bump or normal map", "merge the two maps")
    return nested


def _holds(bsdf: Bsdf, kinds: Any) -> bool:
    if isinstance(bsdf, kinds):
        return True
    if isinstance(bsdf, TwoSidedBsdf):
        return _holds(bsdf.front, kinds) or _holds(bsdf.back, kinds)
    return isinstance(bsdf, MaskBsdf | BumpMapBsdf | NormalMapBsdf) and _holds(bsdf.nested, kinds)


def _transmits(bsdf: Bsdf) -> bool:
    # What a twosided holds has been checked when it was read
    if isinstance(bsdf, BumpMapBsdf | NormalMapBsdf):
        return _transmits(bsdf.nested)
    return isinstance(bsdf, DielectricBsdf | ThinDielectricBsdf | MaskBsdf)


_READERS = {
    "diffuse": _diffuse,
    "conductor": _conductor,
    "roughconductor": _rough_conductor,
    "bumpmap": _bump_map,
    "normalmap": _normal_map,
    "dielectric": _dielectric,
    "thindielectric": _dielectric,
    "twosided": _two_sided,
    "mask": _mask,
}
