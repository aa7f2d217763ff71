"""Places in a scene's tables whose values may change, and carry derivatives, from one render to the next."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import drjit as dr


class Place(NamedTuple):
    """One value of a scene: ``field`` of the object ``owner`` of its description, as it was loaded."""

    owner: Any
    field: str


Values: TypeAlias = Callable[[Place], Any]
"""The present value of a place, in the precision of who asks, with the derivatives that it carries."""


class Live:
    """Which values of a description may change. Tables hold these in buffers of their own: none is merged with an equal
    one, left out because it is 1 or 0, or made part of a kernel.

    ``originals``: descriptions that stand for those of ``places`` (with newer values) by their ids.
    """

    def __init__(self, places: Iterable[Place] = (), originals: Mapping[int, Any] | None = None) -> None:
        self.places = frozenset(places)
        self._originals = dict(originals or {})
        self._ids = {(id(p.owner), p.field): p for p in self.places}

    def place(self, owner: Any, field: str) -> Place | None:
        """The place that ``field`` of ``owner`` is, if its value may change."""
        if not self._ids:
            return None
        return self._ids.get((id(self._originals.get(id(owner), owner)), field))

    def has(self, owner: Any, *fields: str) -> bool:
        """Whether the value of any of ``fields`` may change."""
        return any(self.place(owner, field) is not None for field in fields)

    def standing_for(self, others: Sequence[Any], owners: Sequence[Any]) -> Live:
        """What is live of ``others``, descriptions made of ``owners`` one by one."""
        pairs = zip(others, owners, strict=True)
        return Live(self.places, {id(other): self._originals.get(id(owner), owner) for other, owner in pairs})


#: Nothing changes.
STILL = Live()


@dataclass(frozen=True, eq=False)
class Slot:
    """``holder.attribute``, a PyTree of Dr.Jit arrays that kernels read.

    ``moves``: rays go elsewhere when it changes, as they do with positions, normals, roughness and indices of
    refraction, but not with colours. ``places`` are the values that it is made of: :meth:`made`, by ``make(base,
    values)``, in which ``base`` is what it was when the slot was made.
    """

    holder: Any
    attribute: str
    moves: bool
    places: tuple[Place, ...] = ()
    make: Callable[[Any, Values], Any] | None = None
    base: Any = None

    @staticmethod
    def of(
        holder: Any, attribute: str, places: Iterable[Place], make: Callable[[Any, Values], Any], *, moves: bool
    ) -> Slot:
        """The slot of what ``holder`` has now."""
        return Slot(holder, attribute, moves, tuple(places), make, getattr(holder, attribute))

    @property
    def value(self) -> Any:
        """What kernels read now."""
        return getattr(self.holder, self.attribute)

    def assign(self, value: Any) -> None:
        """Lets kernels read ``value``, which has the types of the one before."""
        # Tables are frozen, so that nothing else does this.
        object.__setattr__(self.holder, self.attribute, value)

    def made(self, values: Values) -> Any:
        """What kernels shall read for ``values``, with derivatives by those that carry any."""
        return self.base if self.make is None else self.make(self.base, values)


def derived(slots: Iterable[Slot], places: Iterable[Place], through: Callable[[Values], Values]) -> list[Slot]:
    """``slots`` whose values are not those of ``places`` but made of them: what ``through`` gives."""
    all_places = tuple(places)

    def wrapped(slot: Slot) -> Callable[[Any, Values], Any]:
        return lambda base, values: slot.made(through(values))

    return [Slot(s.holder, s.attribute, s.moves, all_places, wrapped(s), s.base) for s in slots]


def derived_each(slots: Iterable[Slot], through: Callable[[Values], Values]) -> list[Slot]:
    """:func:`derived` of slots whose places stay, each its own."""
    return [found for slot in slots for found in derived([slot], slot.places, through)]


@contextmanager
def bound(slots: Sequence[Slot], values: Sequence[Any]) -> Iterator[None]:
    """While it lasts, kernels read ``values`` in the places of those in ``slots``."""
    before = [slot.value for slot in slots]
    try:
        for slot, value in zip(slots, values, strict=True):
            slot.assign(value)
        yield
    finally:
        for slot, value in zip(slots, before, strict=True):
            slot.assign(value)


def put(buffer: Any, first: int, words: Sequence[Any]) -> None:
    """Writes ``words`` (Floats of width 1) into ``buffer`` from position ``first`` on, with their derivatives."""
    UInt = dr.uint32_array_t(type(buffer))
    for k, word in enumerate(words):
        dr.scatter(buffer, type(buffer)(word), UInt(first + k))


def channels(value: Any) -> list[Any]:
    """A colour as three Floats: those of an Array3f, or a Float three times."""
    return [value[k] for k in range(3)] if dr.depth_v(value) > 1 else [value] * 3
