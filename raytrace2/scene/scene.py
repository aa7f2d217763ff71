"""Scene: a description together with the device buffers that rendering it takes, made as they are asked for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..accel.build import build
from ..errors import GeometryError, Problem, SceneError
from ..surfaces.door import origin_of
from ..surfaces.hit import Hit
from ..surfaces.instance import Instance
from ..surfaces.interaction import SurfaceInteraction
from ..surfaces.mesh import TriangleMesh
from ..surfaces.quadrics import Cylinder, Disk, Rectangle, Sphere
from ..surfaces.structure import Structure
from ..surfaces.surface import Surface
from ..textures.filter_settings import FilterSettings
from ..types import types_of
from . import description
from .traced import TracedScene

_QUADRICS: dict[type[description.Shape], type[Surface]] = {
    description.SphereShape: Sphere,
    description.RectangleShape: Rectangle,
    description.DiskShape: Disk,
    description.CylinderShape: Cylinder,
}


class Scene:
    """What ``rt.load_file`` gives: a frozen ``description`` and, per precision and structure, a :class:`TracedScene`.

    ``accel`` is the structure used where none is named: the scene's own setting, or ``"bvh"``; ``intersection``
    likewise, ``"watertight"`` unless the scene says ``"fast"``.
    """

    def __init__(
        self, source: description.SceneDescription, origin: Any = None, parameters: dict[str, Any] | None = None
    ) -> None:
        self.description = source
        #: What the scene was loaded from (a path, XML text or a dict) and with which parameters, for the reference
        #: renderer.
        self.origin = origin
        self.parameters = dict(parameters or {})
        self.accel = source.settings.get("accel", "bvh")
        self.intersection = source.settings.get("intersection", "watertight")
        #: The texture filter and the differentials that the scene asks for, used where none are named.
        self.filter = source.settings.get("filter")
        self.differentials = source.settings.get("differentials")
        self._leaves: dict[int, Surface] = {}
        self._structures: dict[tuple[str, str, str], Structure] = {}
        self._traced: dict[tuple[Structure, FilterSettings | None], TracedScene] = {}
        self._check_geometry()

    def traced(
        self,
        accel: str | None = None,
        precision: str = "float32",
        filter: FilterSettings | None = None,
        intersection: str | None = None,
    ) -> TracedScene:
        """The scene in the form that kernels read, built on the first call for each combination of arguments.

        ``filter`` takes the place of every bitmap's own if given.
        """
        key = (accel or self.accel, precision, intersection or self.intersection)
        if key not in self._structures:
            self._structures[key] = self._build(*key)
        structure = self._structures[key]
        if (structure, filter) not in self._traced:
            shapes = {id(surface): shape for shape, surface in self._shape_surfaces()}
            self._traced[structure, filter] = TracedScene(self.description, structure, shapes, filter)
        return self._traced[structure, filter]

    def intersect(self, ray: Any, active: Any = True) -> Hit:
        """The closest hit of each active ray, in the precision of the rays."""
        return self._for(ray).structure.intersect(ray, active)

    def occluded(self, ray: Any, active: Any = True) -> Any:
        """Bool: whether anything lies between tmin and tmax on each active ray."""
        return self._for(ray).structure.occluded(ray, active)

    def interact(self, ray: Any, hit: Hit) -> SurfaceInteraction:
        """The local geometry where ``ray`` met a surface at ``hit``."""
        return self._for(ray).structure.interact(ray, hit)

    def __repr__(self) -> str:
        d = self.description
        counts = f"{len(d.shapes)} shapes, {len(d.lights)} lights, {len(d.cameras)} cameras"
        return f"Scene({d.source or 'in memory'}: {counts})"

    def _for(self, ray: Any) -> TracedScene:
        return self.traced(precision=types_of(origin_of(ray)).precision)

    def _build(self, accel: str, precision: str, intersection: Any) -> Structure:
        groups: dict[int, Structure] = {}
        items: list[Surface] = []
        for shape in self.description.shapes:
            if isinstance(shape, description.InstanceShape):
                group = shape.group
                if id(group) not in groups:
                    members = [self._surface(s) for s in group.shapes]
                    groups[id(group)] = build(members, accel, precision=precision, intersection=intersection)
                items.append(Instance(groups[id(group)], shape.to_world, name=shape.id))
            else:
                items.append(self._surface(shape))
        return build(items, accel, precision=precision, intersection=intersection)

    def _surface(self, shape: description.Shape) -> Surface:
        if id(shape) not in self._leaves:
            self._leaves[id(shape)] = _make_surface(shape)
        return self._leaves[id(shape)]

    def _shape_surfaces(self) -> Sequence[tuple[description.Shape, Surface]]:
        return [(shape, self._surface(shape)) for shape in _leaf_shapes(self.description.shapes)]

    def _check_geometry(self) -> None:
        problems = []
        for shape in _leaf_shapes(self.description.shapes):
            try:
                self._surface(shape)
            except GeometryError as error:
                problems.append(Problem(str(error), shape.location))
        if problems:
            raise SceneError(problems)


def _leaf_shapes(shapes: Sequence[description.Shape]) -> list[description.Shape]:
    leaves: list[description.Shape] = []
    seen: set[int] = set()
    for shape in shapes:
        if isinstance(shape, description.InstanceShape):
            if id(shape.group) not in seen:
                seen.add(id(shape.group))
                leaves.extend(shape.group.shapes)
        else:
            leaves.append(shape)
    return leaves


def _make_surface(shape: description.Shape) -> Surface:
    if isinstance(shape, description.MeshShape):
        return TriangleMesh(shape.vertices, shape.faces, shape.uv, shape.normals, name=shape.id)
    quadric: Any = _QUADRICS[type(shape)]
    return quadric(shape.to_world, shape.flip_normals, name=shape.id)  # type: ignore[attr-defined]
