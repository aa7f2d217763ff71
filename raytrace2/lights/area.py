"""Area lights: shapes that emit the same radiance in every direction from their front."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..errors import Problem, SceneError
from ..live import Live, Place, Slot, Values, channels, put
from ..scene import description
from ..types import Types
from .area_flat import CylinderLights, DiskLights, RectangleLights
from .area_live import Area, area_slots
from .area_mesh import MeshLights
from .area_sphere import SphereLights
from .sample import LightSample, finite_or_zero, pack, towards
from .shape_sample import solid_angle

_NONE = 0xFFFFFFFF
_KINDS: tuple[type[description.Shape], ...] = (
    description.MeshShape,
    description.RectangleShape,
    description.DiskShape,
    description.CylinderShape,
    description.SphereShape,
)


@dataclass(frozen=True, eq=False)
class AreaLights:
    """``order``: which of the shapes given each light is; lights of one shape kind follow each other. ``kinds``: those
    present, each with its first light and how many there are (UInt, opaque). ``emission``: per light radiance and area.
    ``texture``: UInt indices that replace the radiance, or None if no light has a texture; ``reach``: what they can
    meet."""

    types: Types
    order: tuple[int, ...]
    kinds: tuple[tuple[Any, Any, Any], ...]
    emission: Any
    texture: Any
    reach: Any
    textures: Any

    @staticmethod
    def build(shapes: Sequence[description.Shape], textures: Any, types: Types) -> AreaLights:
        """Raises ``SceneError`` for shapes that cannot emit and radiance that needs more than surface coordinates."""
        problems = [p for p in map(_problem, shapes) if p]
        if problems:
            raise SceneError(problems)
        order = sorted(range(len(shapes)), key=lambda i: _KINDS.index(_kind(shapes[i])))
        sorted_shapes = [shapes[i] for i in order]
        emission = np.zeros((len(shapes), 4))
        texture = np.full(len(shapes), _NONE, dtype=np.uint32)
        for i, shape in enumerate(sorted_shapes):
            assert shape.emitter is not None
            radiance = shape.emitter.radiance
            if isinstance(radiance, description.ConstantTexture):
                emission[i, :3] = radiance.value
            else:
                texture[i] = textures.add(radiance)
            emission[i, 3] = surface_area(shape, types)
        textured = bool((texture != _NONE).any())
        kinds = []
        first = 0
        for kind in _KINDS:
            group: Any = [s for s in sorted_shapes if _kind(s) is kind]
            if group:
                span = dr.opaque(types.UInt, first), dr.opaque(types.UInt, len(group))
                kinds.append((_BUILDERS[kind](group, textured, types), *span))
                first += len(group)
        return AreaLights(
            types,
            tuple(order),
            tuple(kinds),
            pack(emission, types),
            types.UInt(texture) if textured else None,
            textures.reach(texture[texture != _NONE].tolist()) if textured else None,
            textures,
        )

    def slots(self, shapes: Sequence[description.Shape], live: Live) -> list[Slot]:
        """Those of live radiance of one colour and of surfaces that may move; ``shapes`` are those given to
        :meth:`build`."""
        places: dict[int, Place] = {}
        areas: dict[int, tuple[Place, Area]] = {}
        found: list[Slot] = []
        first = 0
        ordered = [shapes[which] for which in self.order]
        for kind, (table, _, _) in zip(sorted({_KINDS.index(_kind(s)) for s in ordered}), self.kinds, strict=True):
            group = [s for s in ordered if _kind(s) is _KINDS[kind]]
            slots, some = area_slots(table, group, live)
            found += slots
            areas |= {first + k: area for k, area in some.items()}
            first += len(group)
        for light, which in enumerate(self.order):
            emitter = shapes[which].emitter
            assert emitter is not None
            place = live.place(emitter.radiance, "value")
            if place is not None:
                places[light] = place

        def make(base: Any, values: Values) -> Any:
            buffer = type(base)(base)
            for light, place in places.items():
                put(buffer, 4 * light, channels(values(place)))
            for light, (_, area) in areas.items():
                put(buffer, 4 * light + 3, [area(values)])
            return buffer

        if places or areas:
            all_places = {*places.values(), *(place for place, _ in areas.values())}
            found.append(Slot.of(self, "emission", all_places, make, moves=bool(areas)))
        return found

    def sample(self, p: Any, index: Any, u: Any, active: Any) -> LightSample:
        """A point on light ``index`` as seen from ``p``, from ``u`` (Array2f)."""
        types = self.types
        result = None
        for lights, first, count in self.kinds:
            mine = self._mine(index, first, count, active)
            drawn = lights.sample(p, index - first, u, mine)
            result = drawn if result is None else dr.select(mine, drawn, result)
        assert result is not None
        active = active & result.front
        radiance = dr.gather(types.Array4f, self.emission, index, active).xyz
        if self.texture is not None:
            texture = dr.gather(types.UInt, self.texture, index, active)
            textured = active & (texture != _NONE)
            texel = self.textures.eval_uv(dr.select(textured, texture, 0), result.uv, textured, reach=self.reach)
            radiance = dr.select(textured, texel, radiance)
        weight, pdf = finite_or_zero(radiance * result.inverse, result.pdf, active)
        return LightSample(result.d, result.dist, weight, pdf, types.Bool(False), result.p)

    def eval(self, si: Any, index: Any, active: Any) -> Any:
        """Radiance (Array3f) that light ``index`` sends from ``si`` along ``si.wi``; 0 from its back."""
        types = self.types
        active = active & (si.wi.z > 0)
        radiance = dr.gather(types.Array4f, self.emission, index, active).xyz
        if self.texture is not None:
            texture = dr.gather(types.UInt, self.texture, index, active)
            textured = active & (texture != _NONE)
            texel = self.textures.eval(dr.select(textured, texture, 0), si, textured, reach=self.reach)
            radiance = dr.select(textured, texel, radiance)
        return dr.select(active, radiance, 0)

    def pdf(self, p: Any, si: Any, index: Any, active: Any) -> Any:
        """The density per steradian with which :meth:`sample` from ``p`` finds the point ``si`` of light ``index``."""
        types = self.types
        active = active & (si.wi.z > 0)
        area: Any = None
        result: Any = None
        for lights, first, count in self.kinds:
            mine = self._mine(index, first, count, active)
            if isinstance(lights, SphereLights):
                inverse = lights.inverse_pdf(p, index - first, si.p, si.n, mine)
                result = inverse
                continue
            if area is None:
                area = dr.gather(types.Array4f, self.emission, index, active).w
            if isinstance(lights, CylinderLights):
                area = dr.select(mine, lights.area(index - first, si.uv, mine), area)
        if area is not None:
            d, dist = towards(p, si.p)
            inverse = solid_angle(area, d, dist, si.n)
            # Spheres come last of all kinds.
            result = inverse if result is None else dr.select(mine, result, inverse)
        pdf = dr.rcp(result)
        return dr.select(active & (pdf <= types.largest), pdf, 0)

    def _mine(self, index: Any, first: Any, count: Any, active: Any) -> Any:
        return active if len(self.kinds) == 1 else active & (index >= first) & (index - first < count)


_BUILDERS: dict[type[description.Shape], Any] = {
    description.MeshShape: MeshLights.build,
    description.RectangleShape: lambda group, textured, types: RectangleLights.build(group, types),
    description.DiskShape: DiskLights.build,
    description.CylinderShape: lambda group, textured, types: CylinderLights.build(group, types),
    description.SphereShape: SphereLights.build,
}


def surface_area(shape: description.Shape, types: Types) -> float:
    """The area of ``shape``; of a cylinder, only where its cross-section is a circle square to its axis."""
    if isinstance(shape, description.MeshShape):
        corners = shape.vertices.astype(types.numpy).astype(np.float64)[shape.faces]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return float(0.5 * np.linalg.norm(cross, axis=1).sum())
    x, y, z = shape.to_world[:3, :3].T  # type: ignore[attr-defined]
    if isinstance(shape, description.SphereShape):
        return float(4 * np.pi * (x @ x))
    if isinstance(shape, description.CylinderShape):
        return float(2 * np.pi * np.linalg.norm(x) * np.linalg.norm(z))
    return float((np.pi if isinstance(shape, description.DiskShape) else 4.0) * np.linalg.norm(np.cross(x, y)))


def _kind(shape: description.Shape) -> type[description.Shape]:
    return next(k for k in _KINDS if isinstance(shape, k))


def _problem(shape: description.Shape) -> Problem | None:
    name = f"shape '{shape.id}'"
    if not isinstance(shape, _KINDS):
        return Problem(
            f"{name} of kind {type(shape).__name__} cannot emit light",
            shape.location,
            "attach the emitter to a mesh, rectangle, disk, cylinder or sphere outside any instance",
        )
    if isinstance(shape, description.MeshShape) and len(shape.faces) == 0:
        return Problem(f"{name} emits light but has no faces", shape.location, "remove it or its emitter")
    if shape.emitter is None:
        return Problem(f"{name} has no emitter", shape.location, "list only shapes that emit")
    if _needs_mesh(shape.emitter.radiance):
        return Problem(f"the radiance of {name} is a mesh attribute", shape.location, "use a constant or a bitmap")
    return None


def _needs_mesh(texture: description.Texture) -> bool:
    if isinstance(texture, description.CheckerboardTexture):
        return _needs_mesh(texture.color0) or _needs_mesh(texture.color1)
    return isinstance(texture, description.MeshAttributeTexture)
