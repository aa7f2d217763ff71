"""Primitives: like or unlike things in one buffer of records, met by index inside a symbolic loop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol

import drjit as dr
import numpy as np

from ..buffers import owned, owned_rows
from ..types import Types
from . import quadric_tests, record
from .hit import Candidate
from .triangle import Shear, intersect_triangle, shear_of
from .triangle_fast import intersect_triangle_fast

#: How surely rays meet triangles and boxes: without a gap, or as quickly as can be.
Intersection = Literal["watertight", "fast"]

_QUADRIC_TESTS: dict[int, Callable[..., tuple[Any, Any, Any, Any]]] = {
    record.SPHERE: quadric_tests.intersect_sphere,
    record.RECTANGLE: quadric_tests.intersect_rectangle,
    record.DISK: quadric_tests.intersect_disk,
    record.CYLINDER: quadric_tests.intersect_cylinder,
}


class Traversable(Protocol):
    """A structure, or a batch of like ones told apart by ``root``, that another's traversal can enter."""

    @property
    def has_instances(self) -> bool:
        """Whether a hit may have been met through an instance."""
        ...

    @property
    def exponent(self) -> int:
        """The power of two that is the unit of its lengths."""
        ...

    def traverse(self, ray: LocalRay, best: Candidate, root: Any, active: Any) -> Candidate:
        """The closest hit of each active ray no farther than ``best.t``; ``best`` where there is none."""
        ...

    def traverse_any(self, ray: LocalRay, root: Any, active: Any) -> Any:
        """Bool: whether an active ray meets anything between its tmin and tmax."""
        ...


@dataclass
class LocalRay:
    """A ray in the coordinates and the unit of the structure being traversed, with a shear if there are triangles to
    test watertight."""

    o: Any
    d: Any
    tmin: Any
    tmax: Any
    shear: Shear | None = None


@dataclass(frozen=True, eq=False)
class Primitives:
    """``records`` (n, 16) as :mod:`.record` lays them out, and the bounds ``lo``, ``hi`` (n, 3) of each, on the host.

    ``kinds`` are the record kinds present, in the order of the codes; a ray test of a kind that is absent adds no
    operation to a kernel. ``nested`` are the structures that records of kind INSTANCE and NESTED lead into; a
    record's KIND word is ``kind + 8 * (position in nested)``. Bounds enclose the geometry *as the records hold it*.
    Lengths are in units of 2^``exponent``. ``intersection`` says which test triangles get.
    """

    types: Types
    records: np.ndarray
    lo: np.ndarray
    hi: np.ndarray
    kinds: tuple[int, ...]
    nested: tuple[Traversable, ...] = ()
    exponent: int = 0
    intersection: Intersection = "watertight"

    def __len__(self) -> int:
        return len(self.records)

    @property
    def has_instances(self) -> bool:
        """Whether a hit may have been met through an instance."""
        return record.INSTANCE in self.kinds or any(n.has_instances for n in self.nested)

    def reordered(self, order: np.ndarray) -> Primitives:
        """The same primitives in the order that a structure's leaves want, repeated where ``order`` repeats."""
        return replace(self, records=self.records[order], lo=self.lo[order], hi=self.hi[order])

    @staticmethod
    def join(parts: Sequence[Primitives]) -> Primitives:
        """All primitives of ``parts``, which share precision, unit and test; only one may lead into nested
        structures."""
        if len(parts) == 1:
            return parts[0]
        nested = [p for p in parts if p.nested]
        assert len(nested) <= 1
        return Primitives(
            parts[0].types,
            np.concatenate([p.records for p in parts]),
            np.concatenate([p.lo for p in parts]),
            np.concatenate([p.hi for p in parts]),
            tuple(sorted({k for p in parts for k in p.kinds})),
            nested[0].nested if nested else (),
            parts[0].exponent,
            parts[0].intersection,
        )

    def upload(self, order: np.ndarray | None = None) -> DevicePrimitives:
        """The records in a device buffer, ready to be met; in the order of the indices ``order``, if given."""
        if order is None:
            buffer = owned(self.records, self.types.Float)
        else:
            buffer = owned_rows(self.records, order, self.types)
        return DevicePrimitives(
            self.types, buffer, self.kinds, self.nested, self.has_instances, self.exponent, self.intersection
        )


@dataclass(frozen=True, eq=False)
class DevicePrimitives:
    """The records of :class:`Primitives` on the device: what traversals call."""

    types: Types
    buffer: Any
    kinds: tuple[int, ...]
    nested: tuple[Traversable, ...]
    has_instances: bool
    exponent: int
    intersection: Intersection

    def prepare(self, ray: Any) -> LocalRay:
        """What ray tests need, computed once per ray."""
        sheared = record.TRIANGLE in self.kinds and self.intersection == "watertight"
        return LocalRay(ray.o, ray.d, ray.tmin, ray.tmax, shear_of(ray) if sheared else None)

    def intersect_one(self, i: Any, ray: LocalRay, best: Candidate) -> Candidate:
        """Primitive ``i`` against each ray (every lane takes part): the nearer of it and ``best``.

        Of two hits at the same t the one with the smaller number wins, so that every structure gives the same answer.
        """
        words = record.load_words(self.buffer, i, self.types)
        id = record.decode_integer(words[record.ID], self.types)
        if len(self._codes()) == 1:
            return self._meet(self.kinds[0], 0, words, id, ray, best)
        code = record.decode_integer(words[record.KIND], self.types)
        for kind, place in self._codes():
            best = dr.if_stmt(
                (best,),
                code == kind + 8 * place,
                lambda b, kind=kind, place=place: (self._meet(kind, place, words, id, ray, b),),
                lambda b: (b,),
            )[0]
        return best

    def occludes_one(self, i: Any, ray: LocalRay) -> Any:
        """Bool: whether primitive ``i`` lies between tmin and tmax on each ray."""
        words = record.load_words(self.buffer, i, self.types)
        if len(self._codes()) == 1:
            return self._occludes(self.kinds[0], 0, words, ray)
        code = record.decode_integer(words[record.KIND], self.types)
        blocked = dr.full(self.types.Bool, False, dr.width(i))
        for kind, place in self._codes():
            blocked = dr.if_stmt(
                (blocked,),
                code == kind + 8 * place,
                lambda b, kind=kind, place=place: (b | self._occludes(kind, place, words, ray),),
                lambda b: (b,),
            )[0]
        return blocked

    def _codes(self) -> list[tuple[int, int]]:
        """Every (kind, place in nested) that records may bear."""
        leads_inside = (record.INSTANCE, record.NESTED)
        return [(k, place) for k in self.kinds for place in (range(len(self.nested)) if k in leads_inside else (0,))]

    def _meet(self, kind: int, place: int, words: list[Any], id: Any, ray: LocalRay, best: Candidate) -> Candidate:
        if kind in (record.INSTANCE, record.NESTED):
            return self._enter(kind, place, words, id, ray, best)
        inside, t, u, v = self._line_test(kind, words, ray, best.t)
        best = best.counted(primitives=1)
        closer = inside & (t >= ray.tmin) & ((t < best.t) | ((t == best.t) & (id < best.id)))
        return Candidate(
            dr.select(closer, t, best.t),
            dr.select(closer, u, best.u),
            dr.select(closer, v, best.v),
            dr.select(closer, id, best.id),
            None if best.instance is None else dr.select(closer, record.NONE, best.instance),
            best.counts,
        )

    def _occludes(self, kind: int, place: int, words: list[Any], ray: LocalRay) -> Any:
        if kind in (record.INSTANCE, record.NESTED):
            root = record.decode_integer(words[record.ROOT], self.types)
            return self.nested[place].traverse_any(self._into(kind, place, words, ray), root, True)
        inside, t, _, _ = self._line_test(kind, words, ray, ray.tmax)
        return inside & (t >= ray.tmin) & (t <= ray.tmax)

    def _line_test(self, kind: int, words: list[Any], ray: LocalRay, tmax: Any) -> tuple[Any, Any, Any, Any]:
        if kind == record.TRIANGLE and self.intersection == "fast":
            return intersect_triangle_fast(words, ray)
        if kind == record.TRIANGLE:
            assert ray.shear is not None
            return intersect_triangle(words, ray, ray.shear)
        return _QUADRIC_TESTS[kind](words, ray, ray.tmin, tmax)

    def _into(self, kind: int, place: int, words: list[Any], ray: LocalRay) -> LocalRay:
        """The ray in the coordinates of a nested structure; not normalised, so that t means the same inside."""
        if kind == record.NESTED:
            factor = 2.0 ** (self.exponent - self.nested[place].exponent)
            o, d = (ray.o, ray.d) if factor == 1 else (ray.o * factor, ray.d * factor)
            return LocalRay(o, d, ray.tmin, ray.tmax)
        rows = [words[4 * k : 4 * k + 4] for k in range(3)]
        o, d = ray.o, ray.d
        return LocalRay(
            type(o)(*(dr.fma(a, o.x, dr.fma(b, o.y, dr.fma(c, o.z, t))) for a, b, c, t in rows)),
            type(d)(*(dr.fma(a, d.x, dr.fma(b, d.y, c * d.z)) for a, b, c, _ in rows)),
            ray.tmin,
            ray.tmax,
        )

    def _enter(self, kind: int, place: int, words: list[Any], offset: Any, ray: LocalRay, best: Candidate) -> Candidate:
        """The closest hit inside a nested structure. A nested record's ID word is what to add to the numbers inside;
        its last word an instance's own number, or what to add to the numbers of instances inside."""
        UInt, width = self.types.UInt, dr.width(best.t)
        inner = self.nested[place]
        start = Candidate(
            best.t,
            dr.zeros(type(best.u), width),
            dr.zeros(type(best.v), width),
            dr.full(UInt, record.NONE, width),
            dr.full(UInt, record.NONE, width) if inner.has_instances else None,
            best.counts,
        )
        root = record.decode_integer(words[record.ROOT], self.types)
        found = inner.traverse(self._into(kind, place, words, ray), start, root, True)
        id = found.id + offset
        before = id < best.id
        met = None
        if best.instance is not None:
            number = record.decode_integer(words[record.INSTANCE_NUMBER], self.types)
            if kind == record.INSTANCE:
                met = number
            elif found.instance is None:
                met = UInt(record.NONE)
            else:
                met = dr.select(found.instance == record.NONE, record.NONE, found.instance + number)
            before |= (id == best.id) & (met < best.instance)
        closer = (found.id != record.NONE) & ((found.t < best.t) | ((found.t == best.t) & before))
        instance = None if best.instance is None else dr.select(closer, met, best.instance)
        return Candidate(
            dr.select(closer, found.t, best.t),
            dr.select(closer, found.u, best.u),
            dr.select(closer, found.v, best.v),
            dr.select(closer, id, best.id),
            instance,
            found.counts,
        )
