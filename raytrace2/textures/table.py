"""All textures of a scene, met by index inside kernels."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import drjit as dr
import numpy as np

from ..live import STILL, Live, Slot
from ..scene.description import (
    BitmapTexture,
    CheckerboardTexture,
    ConstantTexture,
    FbmTexture,
    MeshAttributeTexture,
    MeshShape,
    Texture,
)
from ..types import Types
from . import handle as handles
from .bitmap import Bitmaps, check_bitmap
from .checkerboard import Checkerboards, checker_scale
from .color import luminance
from .constant import Constants
from .filter_settings import FilterSettings
from .mesh_attribute import MeshAttributes
from .noise import Fbms

_CONSTANT, _CHECKERBOARD, _VERTEX_ATTRIBUTE, _FACE_ATTRIBUTE, _FBM, _FIRST_BITMAP = range(6)
_FORMATS = [(dtype, channels) for dtype in ("uint8", "float16", "float") for channels in (3, 1)]

Reach: TypeAlias = tuple[frozenset[int], ...]
"""Kinds of texture that a look-up can meet, one set a level of checkerboards; the last holds no checkerboard."""


class TextureTable:
    """Textures by index (:meth:`add` gives it; it is a handle, not a position), in one table a kind.

    Kernels hold the kinds that occur and nothing of the rest, and fewer still where a look-up says what it can meet
    (``reach``). ``attributes`` maps surface indices to the meshes whose attributes textures read; ``settings`` take
    the place of every bitmap's own filter; textures that are ``live`` stay apart from equal ones.
    """

    def __init__(
        self,
        types: Types,
        attributes: Mapping[int, MeshShape] | None = None,
        settings: FilterSettings | None = None,
        live: Live = STILL,
    ) -> None:
        self.types = types
        self.settings = settings
        self.live = live
        self._moving: set[int] = set()
        self._meshes = dict(attributes or {})
        self._members: dict[int, list[Any]] = {}
        self._children: list[tuple[int, int]] = []
        self._known: dict[Any, int] = {}
        self._keep: list[Texture] = []
        self._tables: dict[int, Any] = {}
        self._all: Reach = (frozenset(),)
        self._stale = False

    @staticmethod
    def build(
        textures: Sequence[Texture], types: Types, *, attributes: Mapping[int, MeshShape] | None = None
    ) -> TextureTable:
        """A table of ``textures``; ``add(texture)`` tells the index of each."""
        table = TextureTable(types, attributes)
        for texture in textures:
            table.add(texture)
        table.finish()
        return table

    def add(self, texture: Texture, *, moves: bool = False) -> int:
        """The index of ``texture``, which joins the table unless it (or a constant equal to it) is there.

        ``moves``: where rays go depends on it.
        """
        constant = isinstance(texture, ConstantTexture) and not self.live.has(texture, "value")
        key = texture.value if constant else id(texture)  # type: ignore[union-attr]
        if key not in self._known:
            kind = _kind(texture)
            if isinstance(texture, CheckerboardTexture):
                children = self.add(texture.color0, moves=moves), self.add(texture.color1, moves=moves)
                self._children.append(children)
            members = self._members.setdefault(kind, [])
            self._known[key] = handles.make(kind, len(members))
            members.append(texture)
            self._keep.append(texture)
            self._tables.pop(kind, None)
            self._stale = True
        if moves:
            self._moving.add(self._known[key])
        return self._known[key]

    def finish(self) -> None:
        """Makes the buffers of what was added since the last time; look-ups do it too, but had better not in a loop."""
        for kind, members in self._members.items():
            if kind not in self._tables:
                self._tables[kind] = self._make(kind, members)
        self._all = self.reach(self._known.values())
        self._stale = False

    def slots(self) -> list[Slot]:
        """Those of live textures."""
        found: list[Slot] = []
        for kind, table in self._tables.items():
            moving = frozenset(handles.place_of(h) for h in self._moving if handles.kind_of(h) == kind)
            if kind == _CONSTANT:
                found += table.slots(moving)
            else:
                found += table.slots(moves=bool(moving))
        return found

    def reach(self, indices: Iterable[int]) -> Reach:
        """What look-ups of ``indices`` can meet; with it a kernel leaves out the other kinds."""
        level = set(indices)
        levels = [frozenset(handles.kind_of(h) for h in level)]
        while _CHECKERBOARD in levels[-1]:
            boards = {h for h in level if handles.kind_of(h) == _CHECKERBOARD}
            level = (level - boards) | {c for h in boards for c in self._children[handles.place_of(h)]}
            levels.append(frozenset(handles.kind_of(h) for h in level))
        return tuple(levels)

    def eval(self, index: Any, si: Any, active: Any = True, *, reach: Reach | None = None) -> Any:
        """The colour (Array3f) of texture ``index`` (UInt, or one Python int) at ``si``."""
        return self._eval(index, si.uv, si, active, reach, single=False)

    def eval_1(self, index: Any, si: Any, active: Any = True, *, reach: Reach | None = None) -> Any:
        """One channel (Float) of texture ``index`` at ``si``: its only one, a constant's mean, others' luminance."""
        return self._eval(index, si.uv, si, active, reach, single=True)

    def eval_uv(self, index: Any, uv: Any, active: Any = True, *, reach: Reach | None = None) -> Any:
        """As :meth:`eval` where there is a ``uv`` (Array2f) but no surface: mesh attributes are black there."""
        return self._eval(index, uv, None, active, reach, single=False)

    def _eval(self, index: Any, uv: Any, si: Any, active: Any, reach: Reach | None, *, single: bool) -> Any:
        if self._stale:
            self.finish()
        active = self.types.Bool(active)
        if isinstance(index, int):
            reach = self.reach((index,))
            index = self.types.UInt(index)
        levels = self._all if reach is None else reach
        if len(levels) > 1 and self._filters_boards(si):
            return self._blend(index, uv, si, active, levels, single)
        for kinds in levels[:-1]:
            index = self._through_boards(index, uv, kinds, active, swapped=single)
        return self._leaf(index, uv, si, active, levels[-1], single)

    def _leaf(self, index: Any, uv: Any, si: Any, active: Any, kinds: frozenset[int], single: bool) -> Any:
        result = None
        for kind in sorted(kinds):
            here = None if len(kinds) == 1 else handles.kind_of(index) == kind
            place = handles.place_of(index)
            value = self._value(kind, place, uv, si, active if here is None else active & here, single)
            result = value if here is None or result is None else dr.select(here, value, result)
        return dr.zeros(self.types.Float if single else self.types.Array3f) if result is None else result

    def _filters_boards(self, si: Any) -> bool:
        settings = self.settings
        return settings is not None and settings.needs_footprint and si is not None and si.footprint is not None

    def _blend(self, index: Any, uv: Any, si: Any, active: Any, levels: Reach, single: bool) -> Any:
        """Both textures of checkerboards, by how much of the footprint they cover."""
        if len(levels) == 1:
            return self._leaf(index, uv, si, active, levels[0], single)
        assert self.settings is not None
        boards, place = self._tables[_CHECKERBOARD], handles.place_of(index)
        here = active & (handles.kind_of(index) == _CHECKERBOARD)
        even, odd = (dr.select(here, h, index) for h in boards.both(place, single, here))
        scale = checker_scale(self.settings.pixel)
        share = dr.select(here, boards.covered(place, uv, si.footprint, scale, here), 0)
        first = self._blend(even, uv, si, active & (share < 1), levels[1:], single)
        second = self._blend(odd, uv, si, active & (share > 0), levels[1:], single)
        # Equal textures stay what they are, and so does either where it is alone.
        mixed = first + share * (second - first)
        return dr.select(share >= 1, second, dr.select(share > 0, mixed, first))

    def _through_boards(self, index: Any, uv: Any, kinds: frozenset[int], active: Any, *, swapped: bool) -> Any:
        # Mitsuba's checkerboard exchanges its colours when it is asked for one channel: so masks come out as there.
        boards, place = self._tables[_CHECKERBOARD], handles.place_of(index)
        if len(kinds) == 1:
            return boards.choose(place, uv, swapped, active)
        here = handles.kind_of(index) == _CHECKERBOARD
        return dr.select(here, boards.choose(place, uv, swapped, active & here), index)

    def _value(self, kind: int, place: Any, uv: Any, si: Any, active: Any, single: bool) -> Any:
        table = self._tables[kind]
        if kind == _CONSTANT:
            value = table.eval(place, active)
        elif kind >= _FIRST_BITMAP:
            value = table.eval(place, uv, None if si is None else si.footprint, active)
            if table.channels == 1:
                return value if single else self.types.Array3f(value)
        elif kind == _FBM:
            value = table.eval(place, uv, None if si is None else si.footprint, active)
        elif si is None:
            value = dr.zeros(self.types.Array3f)
        else:
            value = table.eval(place, si, active)
        if not single:
            return value
        return (value.x + value.y + value.z) / 3 if kind == _CONSTANT else luminance(value)

    def _make(self, kind: int, members: list[Any]) -> Any:
        if kind == _CONSTANT:
            return Constants(members, self.types, self.live)
        if kind == _CHECKERBOARD:
            to_uv, places = [m.to_uv for m in members], [self.live.place(m, "to_uv") for m in members]
            return Checkerboards(np.array(self._children), to_uv, self.types, places)
        if kind == _FBM:
            return Fbms(members, self.types, self.settings, self.live)
        if kind in (_VERTEX_ATTRIBUTE, _FACE_ATTRIBUTE):
            return MeshAttributes(members, 3 if kind == _VERTEX_ATTRIBUTE else 1, self._meshes, self.types, self.live)
        return Bitmaps(members, self.types, self.settings, self.live)


def _kind(texture: Texture) -> int:
    if isinstance(texture, ConstantTexture):
        return _CONSTANT
    if isinstance(texture, CheckerboardTexture):
        return _CHECKERBOARD
    if isinstance(texture, FbmTexture):
        return _FBM
    if isinstance(texture, MeshAttributeTexture):
        if texture.name.startswith("vertex_"):
            return _VERTEX_ATTRIBUTE
        if texture.name.startswith("face_"):
            return _FACE_ATTRIBUTE
        raise ValueError(f"mesh attribute {texture.name!r} must begin with 'vertex_' or 'face_'")
    if isinstance(texture, BitmapTexture):
        check_bitmap(texture)
        name = texture.pixels.dtype.name
        return _FIRST_BITMAP + _FORMATS.index(
            (name if name in ("uint8", "float16") else "float", texture.pixels.shape[2])
        )
    raise TypeError(f"{type(texture).__name__} is no texture")
