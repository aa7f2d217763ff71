"""Values that a mesh carries at its vertices or faces, as textures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..live import STILL, Live, Place, Slot, Values, put
from ..scene.description import MeshAttributeTexture, MeshShape
from ..types import Types

_ABSENT = 0xFFFFFFFF


class MeshAttributes:
    """``vertex_...`` attributes (``corners=3``: a value for each face corner) or ``face_...`` ones (1), by place.

    ``meshes`` maps surface indices, as :class:`SurfaceInteraction` has them, to mesh descriptions. A surface without
    the attribute is black, as in Mitsuba. ``ValueError`` for attributes whose shape does not fit.
    """

    def __init__(
        self,
        textures: Sequence[MeshAttributeTexture],
        corners: int,
        meshes: Mapping[int, MeshShape],
        types: Types,
        live: Live = STILL,
    ) -> None:
        self._types = types
        self._corners = corners
        self._surfaces = max(meshes, default=-1) + 1
        names = sorted({t.name for t in textures})
        offsets = np.full((len(names), max(self._surfaces, 1)), _ABSENT, dtype=np.uint32)
        blocks: list[np.ndarray] = []
        size = 0
        self._live: list[tuple[Place, int, Any, int]] = []
        for i, name in enumerate(names):
            for surface, mesh in meshes.items():
                if name in mesh.attributes:
                    block = _per_corner(mesh, name, corners)
                    offsets[i, surface] = size
                    place = live.place(mesh, f"attributes.{name}")
                    if place is not None:
                        rows = mesh.faces.ravel() if corners == 3 else np.arange(len(mesh.faces))
                        table = owned(rows.astype(np.uint32), types.UInt)
                        self._live.append((place, size, table, _columns(mesh, name)))
                    blocks.append(block)
                    size += len(block)
        if size >= 2**30:
            raise ValueError(f"{size} mesh attribute values are more than the {2**30} that a table holds")
        values = np.concatenate(blocks) if blocks else np.zeros((1, 4))
        self._values = owned(values.astype(types.numpy), types.Float)
        self._offsets = owned(offsets, types.UInt)
        rows = np.array([names.index(t.name) * offsets.shape[1] for t in textures], dtype=np.uint32)
        scales = np.array([t.scale for t in textures], dtype=types.numpy)
        self._live_scales = {k: p for k, t in enumerate(textures) if (p := live.place(t, "scale")) is not None}
        self._unscaled = not self._live_scales and bool((scales == 1).all())
        self._single = len(textures) == 1
        self._rows = owned(rows, types.UInt)
        self._scales = owned(scales, types.Float)

    def slots(self, *, moves: bool) -> list[Slot]:
        """Those of live attributes and scales."""

        def attributes(base: Any, values: Values) -> Any:
            buffer, UInt = type(base)(base), self._types.UInt
            for place, first, rows, columns in self._live:
                value = values(place)
                into = (dr.arange(UInt, dr.width(rows)) + dr.opaque(UInt, first)) * 4
                for k in range(3):
                    number = dr.gather(type(base), value, rows * columns + (k if columns == 3 else 0))
                    dr.scatter(buffer, number, into + k)
            return buffer

        def scales(base: Any, values: Values) -> Any:
            buffer = type(base)(base)
            for k, place in self._live_scales.items():
                put(buffer, k, [values(place)])
            return buffer

        found = [Slot.of(self, "_values", [p for p, *_ in self._live], attributes, moves=moves)] if self._live else []
        if self._live_scales:
            found.append(Slot.of(self, "_scales", self._live_scales.values(), scales, moves=moves))
        return found

    def eval(self, place: Any, si: Any, active: Any) -> Any:
        """The attribute (Array3f; one channel is repeated) interpolated over the face that ``si`` lies on."""
        t = self._types
        active = active & (si.surface < self._surfaces)
        row = self._rows if self._single else dr.gather(t.UInt, self._rows, place, active)
        offset = dr.gather(t.UInt, self._offsets, row + si.surface, active)
        active = active & (offset != _ABSENT)
        first = offset + self._corners * si.prim
        value = dr.gather(t.Array4f, self._values, first, active).xyz
        if self._corners == 3:
            b1, b2 = si.prim_uv.x, si.prim_uv.y
            v1 = dr.gather(t.Array4f, self._values, first + 1, active).xyz
            v2 = dr.gather(t.Array4f, self._values, first + 2, active).xyz
            value = dr.fma(value, 1 - b1 - b2, dr.fma(v1, b1, v2 * b2))
        if self._unscaled:
            return value
        return value * (self._scales if self._single else dr.gather(t.Float, self._scales, place, active))


def _columns(mesh: MeshShape, name: str) -> int:
    return 3 if np.asarray(mesh.attributes[name]).reshape(len(mesh.attributes[name]), -1).shape[1] == 3 else 1


def _per_corner(mesh: MeshShape, name: str, corners: int) -> np.ndarray:
    values = np.asarray(mesh.attributes[name], dtype=np.float64)
    values = values.reshape(len(values), -1)
    wanted = len(mesh.vertices) if corners == 3 else len(mesh.faces)
    if len(values) != wanted or values.shape[1] not in (1, 3):
        raise ValueError(
            f"mesh {mesh.id!r}: attribute {name!r} must have the shape ({wanted}, 1 or 3), not {values.shape}"
        )
    if corners == 3:
        values = values[np.asarray(mesh.faces).ravel()]
    if values.shape[1] == 1:
        values = np.repeat(values, 3, axis=1)
    return np.pad(values, ((0, 0), (0, 1)))
