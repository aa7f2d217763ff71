"""The parameters of a scene and their names, which are those that Mitsuba gives them.

A name is the way from the scene to the value. What stands directly in the scene begins a name with its ``id``; what is
inside something else has its role there (``floor.bsdf.reflectance.data``). What is met twice has its first name only.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from ..live import Place
from ..scene import description as d
from .fields import (
    Attribute,
    Buffer,
    Color,
    Direction,
    Field,
    IndexRatio,
    Number,
    Pixels,
    Point,
    Positions,
    SkyPixels,
    Transform,
)


@dataclass(frozen=True, eq=False)
class Parameter:
    """``parent``: the kind of thing whose value it is."""

    key: str
    place: Place
    field: Field

    @property
    def parent(self) -> str:
        return type(self.place.owner).__name__


def parameters(scene: d.SceneDescription) -> Iterator[Parameter]:
    """Every parameter of ``scene``, each once."""
    seen: set[int] = set()
    taken: set[str] = set()
    named = {id(item) for _, item in scene.names}
    rest = [(getattr(x, "id", ""), x) for x in (*scene.shapes, *scene.lights, *scene.cameras) if id(x) not in named]
    for name, item in (*scene.names, *rest):
        yield from _walk(name or type(item).__name__, item, seen, taken)


def _walk(name: str, item: Any, seen: set[int], taken: set[str]) -> Iterator[Parameter]:
    if id(item) in seen:
        return
    seen.add(id(item))
    base, number = name, 1
    while name in taken:
        name, number = f"{base}_{number}", number + 1
    taken.add(name)
    for role, child in _children(item):
        yield from _walk(f"{name}.{role}", child, seen, taken)
    for key, field in _values(item):
        yield Parameter(f"{name}.{key}", Place(item, _place_name(field)), field)


def _place_name(field: Field) -> str:
    return f"attributes.{field.name}" if isinstance(field, Attribute) else field.name


def _children(item: Any) -> list[tuple[str, Any]]:
    match item:
        case d.InstanceShape():
            return [("shapegroup", item.group)]
        case d.ShapeGroup():
            return [(shape.id, shape) for shape in item.shapes]
        case d.Shape():
            emitter = [] if item.emitter is None else [("emitter", item.emitter)]
            return [("bsdf", item.bsdf), *emitter]
        case d.DiffuseBsdf():
            return [("reflectance", item.reflectance)]
        case d.ConductorBsdf():
            return [("specular_reflectance", item.specular_reflectance), ("eta", item.eta), ("k", item.k)]
        case d.RoughConductorBsdf():
            if item.alpha_u is item.alpha_v:
                alphas = [("alpha", item.alpha_u)]
            else:
                alphas = [("alpha_u", item.alpha_u), ("alpha_v", item.alpha_v)]
            return [("specular_reflectance", item.specular_reflectance), *alphas, ("eta", item.eta), ("k", item.k)]
        case d.DielectricBsdf() | d.ThinDielectricBsdf():
            names = ("specular_reflectance", "specular_transmittance")
            return [(name, getattr(item, name)) for name in names]
        case d.TwoSidedBsdf():
            return [("brdf_0", item.front), ("brdf_1", item.back)]
        case d.MaskBsdf():
            return [("opacity", item.opacity), ("nested_bsdf", item.nested)]
        case d.BumpMapBsdf():
            return [("nested_bsdf", item.nested), ("nested_texture", item.texture)]
        case d.NormalMapBsdf():
            return [("nested_bsdf", item.nested), ("normalmap", item.normalmap)]
        case d.CheckerboardTexture():
            return [("color0", item.color0), ("color1", item.color1)]
        case d.AreaLight():
            return [("radiance", item.radiance)]
        case d.SpotLight():
            return [] if item.texture is None else [("texture", item.texture)]
    return []


def _values(item: Any) -> list[tuple[str, Field]]:
    to_world = "to_world", Transform("to_world")
    match item:
        case d.MeshShape():
            return _mesh_values(item)
        case d.Shape():
            return [("to_world", Transform("to_world", moves_surfaces=True))]
        case d.ConstantTexture():
            return [("value", Color("value"))]
        case d.BitmapTexture():
            return [("data", Pixels("pixels")), ("to_uv", Transform("to_uv", size=3))]
        case d.CheckerboardTexture() | d.FbmTexture():
            return [("to_uv", Transform("to_uv", size=3))]
        case d.MeshAttributeTexture():
            return [("scale", Number("scale"))]
        case d.DielectricBsdf() | d.ThinDielectricBsdf():
            return [("eta", IndexRatio("eta", above=0.0))]
        case d.BumpMapBsdf():
            return [("scale", Number("scale"))]
        case d.PointLight():
            return [("position", Point("position")), ("intensity.value", Color("intensity"))]
        case d.SpotLight():
            angles = [(name, Number(name, above=0.0, below=180.0)) for name in ("cutoff_angle", "beam_width")]
            return [("intensity.value", Color("intensity")), *angles, to_world]
        case d.DirectionalLight():
            return [("irradiance.value", Color("irradiance")), ("to_world", Direction("direction"))]
        case d.ConstantLight():
            return [("radiance.value", Color("radiance"))]
        case d.EnvironmentLight():
            return [("scale", Number("scale")), ("data", SkyPixels("pixels")), to_world]
        case d.Camera():
            return [*_camera_values(item), to_world]
    return []


def _mesh_values(mesh: d.MeshShape) -> list[tuple[str, Field]]:
    found: list[tuple[str, Field]] = [("vertex_positions", Positions("vertices", moves_surfaces=True))]
    if mesh.normals is not None:
        found.append(("vertex_normals", Buffer("normals", moves_surfaces=True, sign=_sign)))
    if mesh.uv is not None:
        found.append(("vertex_texcoords", Buffer("uv", moves_surfaces=True)))
    return found + [(name, Attribute(name)) for name in mesh.attributes]


def _sign(mesh: d.MeshShape) -> float:
    return -1.0 if mesh.flipped else 1.0


def _camera_values(camera: d.Camera) -> list[tuple[str, Field]]:
    found: list[tuple[str, Field]] = []
    if isinstance(camera, d.ThinLensCamera):
        names = "aperture_radius", "focus_distance"
        found += [(name, Number(name, above=0.0)) for name in names]
    if isinstance(camera, d.PerspectiveCamera):
        found.append(("x_fov", Number("x_fov", above=0.0, below=180.0)))
        if not isinstance(camera, d.ThinLensCamera):
            names = "principal_point_offset_x", "principal_point_offset_y"
            found += [(name, Number(name)) for name in names]
    return found
