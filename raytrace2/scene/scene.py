"""Scene: a description together with the device buffers that rendering it takes, made as they are asked for."""

from __future__ import annotations

import gc
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import drjit as dr

from ..accel.build import build
from ..accel.bvh import Bvh
from ..errors import GeometryError, Problem, SceneError
from ..lights.table import check_lights
from ..live import Live, Place
from ..parameters.fields import Field
from ..parameters.store import Store
from ..rays.camera import make_camera
from ..reachable import reachable
from ..surfaces.door import origin_of
from ..surfaces.hit import Hit
from ..surfaces.instance import Instance
from ..surfaces.interaction import SurfaceInteraction
from ..surfaces.mesh import TriangleMesh
from ..surfaces.quadrics import Cylinder, Disk, Rectangle, Sphere
from ..surfaces.structure import Structure
from ..surfaces.surface import Surface
from ..surfaces.transforms import checked_transform
from ..textures.filter_settings import FilterSettings
from ..types import types, types_of
from . import description
from .traced import TracedScene, refuse_while_freezing

_QUADRICS: dict[type[description.Shape], type[Surface]] = {
    description.SphereShape: Sphere,
    description.RectangleShape: Rectangle,
    description.DiskShape: Disk,
    description.CylinderShape: Cylinder,
}


_Key: TypeAlias = tuple[str, str, str]
#: A hierarchy whose boxes have become so much dearer than they were at first is built anew.
_WORN = 2.0


@dataclass(frozen=True, eq=False)
class _Built:
    """A structure over surfaces as they were at a time of the store."""

    structure: Structure
    when: int


class Scene:
    """What ``rt.load_file`` gives: a frozen ``description`` and, per precision and structure, a :class:`TracedScene`.

    ``accel`` is the structure used where none is named: the scene's own setting, or ``"bvh"``; ``intersection``
    likewise, ``"watertight"`` unless the scene says ``"fast"``.

    Functions that Dr.Jit freezes (``dr.freeze``) take a scene, or its parameters, as an argument.
    """

    #: As Dr.Jit sees a scene.
    DRJIT_STRUCT = {"frozen_state": tuple}

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
        #: What has changed since: see :func:`raytrace2.traverse`.
        self.store = Store()
        self._leaves: dict[int, tuple[int, Surface]] = {}
        self._structures: dict[_Key, _Built] = {}
        self._groups: dict[tuple[int, _Key], _Built] = {}
        self._traced: dict[tuple[_Key, FilterSettings | None], TracedScene] = {}
        # Another array whenever a frozen function has assigned values.
        self._written = dr.opaque(types("float32").UInt, 0)
        self._seen = self._written.index
        self._frozen_calls: dict[int, int] = {}
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
        self._notice()
        key = (accel or self.accel, precision, intersection or self.intersection)
        structure = self._structure(key)
        known = self._traced.get((key, filter))
        if known is None or known.live.places != self.store.entries.keys() or not known.refresh(structure):
            refuse_while_freezing()
            source = self.store.current(self.description)
            shapes = {id(surface): shape for shape, surface in self._shape_surfaces(source)}
            known = TracedScene(source, structure, shapes, filter, self.store)
            known.refresh(structure)
            self._traced[key, filter] = known
        return known

    def assign(self, values: Sequence[tuple[str, Place, Field, Any]], *, checked: bool = True) -> None:
        """Gives places new values, each with its name and kind. ``GeometryError`` or ``SceneError`` for what cannot be,
        where that is ``checked``; then nothing has changed."""
        before = dict(self.store.entries)
        if dr.flag(dr.JitFlag.FreezingScope):
            if any(place not in before or field.moves_surfaces for _, place, field, _ in values):
                refuse_while_freezing()
            self._written = dr.opaque(type(self._written), 0)
        for key, place, field, value in values:
            self.store.set(place, field, key, value)
        if not checked:
            return
        owners = {id(place.owner) for _, place, _, _ in values}
        try:
            for shape in _leaf_shapes(self.description.shapes):
                if id(shape) in owners:
                    self._surface(shape, self.store.current(shape))
            for shape in self.description.shapes:
                if isinstance(shape, description.InstanceShape) and id(shape) in owners:
                    checked_transform(self.store.current(shape).to_world, shape.id)
            check_lights([self.store.current(light) for light in self.description.lights if id(light) in owners])
            for camera in self.description.cameras:
                if id(camera) in owners:
                    make_camera(self.store.current(camera), types("float64"))
        except ValueError:
            self.store.restore(before)
            raise

    @property
    def cameras(self) -> tuple[description.Camera, ...]:
        """The cameras as they are now."""
        self._notice()
        return tuple(self.store.current(camera) for camera in self.description.cameras)

    @property
    def frozen_state(self) -> tuple[list[Any], int]:
        """What a function that Dr.Jit freezes reads and writes of the scene: arrays, and a number that is another one
        where kernels may be others. Nothing to functions of Dr.Jit that only look for arrays."""
        if not dr.flag(dr.JitFlag.EnableObjectTraversal):
            return [], 0
        if not dr.flag(dr.JitFlag.FreezingScope):
            # What changes between calls must be in the buffers before the call.
            for ((accel, precision, intersection), filter), before in list(self._traced.items()):
                self.traced(accel, precision, filter, intersection).make_what(before)
        known = self._traced.values()
        values = [entry.value for entry in self.store.entries.values()]
        roots = [self._written, values, *(held for traced in known for held in traced.held())]
        arrays, plain = reachable(roots, (Store, Scene, TracedScene, Live))
        state = hash((plain, *map(id, known)))
        if not dr.flag(dr.JitFlag.FreezingScope):
            self._collect_garbage(state)
        return arrays, state

    def _collect_garbage(self, state: int) -> None:
        """Before a function may be recorded, which is so in the first calls (literals become arrays in these): Dr.Jit
        1.5 ends the process if Python gives NumPy's memory back while it records."""
        calls = self._frozen_calls[state] = self._frozen_calls.get(state, 0) + 1
        if calls <= 9:  # a call looks three times
            gc.collect()

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

    def _notice(self) -> None:
        """Finds out whether a frozen function has changed values since: when it is called again, no Python runs."""
        if self._written.index == self._seen or dr.flag(dr.JitFlag.FreezingScope):
            return
        self._seen = self._written.index
        self.store.touch()
        for traced in self._traced.values():
            traced.notice()

    def _for(self, ray: Any) -> TracedScene:
        return self.traced(precision=types_of(origin_of(ray)).precision)

    def _structure(self, key: _Key) -> Structure:
        """The structure of ``key`` over where surfaces are now: that of before with new boxes, where it can be."""
        when = self.store.moved(self.description)
        known = self._structures.get(key)
        if known is None or known.when != when:
            refuse_while_freezing()
            known = self._structures[key] = _Built(self._moved(known, self._items(key), key), when)
        return known.structure

    def _items(self, key: _Key) -> list[Surface]:
        items: list[Surface] = []
        for original in self.description.shapes:
            shape = self.store.current(original)
            if isinstance(original, description.InstanceShape):
                items.append(Instance(self._group(original.group, key), shape.to_world, name=shape.id))
            else:
                items.append(self._surface(original, shape))
        return items

    def _group(self, group: description.ShapeGroup, key: _Key) -> Structure:
        when = self.store.moved(group)
        known = self._groups.get((id(group), key))
        if known is None or known.when != when:
            members = [self._surface(s, self.store.current(s)) for s in group.shapes]
            known = self._groups[id(group), key] = _Built(self._moved(known, members, key), when)
        return known.structure

    def _moved(self, known: _Built | None, items: list[Surface], key: _Key) -> Structure:
        accel, precision, intersection = key
        if known is None:
            return build(items, accel, precision=precision, intersection=intersection)  # type: ignore[arg-type]
        before = known.structure
        after: Structure
        if isinstance(before, Bvh):
            after = before.refit(items)
            if after.statistics()["refit"]["sah_cost_ratio"] > _WORN:
                after = build(items, accel, precision=precision, intersection=intersection)  # type: ignore[arg-type]
        else:
            after = build(items, accel, precision=precision, intersection=intersection)  # type: ignore[arg-type]
        after.geometry.adopt_shading(before.geometry)
        return after

    def _surface(self, original: description.Shape, shape: description.Shape) -> Surface:
        """The surface of ``shape``, which ``original`` is now."""
        known, when = self._leaves.get(id(original)), self.store.moved(original)
        if known is None or known[0] != when:
            known = self._leaves[id(original)] = when, _make_surface(shape)
        return known[1]

    def _shape_surfaces(self, source: description.SceneDescription) -> Sequence[tuple[description.Shape, Surface]]:
        pairs = zip(_leaf_shapes(self.description.shapes), _leaf_shapes(source.shapes), strict=True)
        return [(shape, self._surface(original, shape)) for original, shape in pairs]

    def _check_geometry(self) -> None:
        problems = []
        for shape in _leaf_shapes(self.description.shapes):
            try:
                self._surface(shape, shape)
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
