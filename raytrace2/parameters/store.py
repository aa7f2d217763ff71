"""The present values of what has changed in a scene since it was loaded, and descriptions that hold them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import drjit as dr
import numpy as np

from ..live import Live, Place, Values
from ..types import Types
from .coercion import converted
from .fields import Field


@dataclass
class Entry:
    """``value``: Dr.Jit arrays of the precision in which it was given, perhaps with derivatives. ``key``: its name;
    ``changed``: the store's clock when it was last set."""

    key: str
    field: Field
    value: Any
    changed: int


class Store:
    """Values by place. ``clock`` counts changes; ``grown`` is its time when the last place joined."""

    def __init__(self) -> None:
        self.entries: dict[Place, Entry] = {}
        self.clock = 0
        self.grown = 0
        self._below: dict[int, tuple[Place, ...]] = {}
        self._current: dict[int, tuple[int, Any, Any]] = {}

    def set(self, place: Place, field: Field, key: str, value: Any) -> None:
        """Gives ``place`` a value; it is live from then on."""
        self.clock += 1
        if place not in self.entries:
            self.grown = self.clock
            self._below.clear()
        self.entries[place] = Entry(key, field, value, self.clock)

    def restore(self, entries: dict[Place, Entry]) -> None:
        """Takes back what was set since ``entries`` were all that there were."""
        self.clock += 1
        self.grown = self.clock
        self._below.clear()
        now = {p: e for p, e in self.entries.items() if e is not entries.get(p)}
        self.entries = {p: replace(e, changed=self.clock) if p in now else e for p, e in entries.items()}

    def touch(self) -> None:
        """Tells that values may have changed unseen, those aside by which surfaces stand."""
        self.clock += 1
        for entry in self.entries.values():
            if not entry.field.moves_surfaces:
                entry.changed = self.clock

    def values(self, types: Types) -> Values:
        """The values, with their derivatives, in the precision of ``types``."""
        return lambda place: converted(self.entries[place].value, types)

    def live(self) -> Live:
        """What is live, as the present descriptions hold it."""
        return Live(self.entries, {id(new): old for _, new, old in self._current.values()})

    def with_derivatives(self) -> list[Place]:
        """The places whose values carry derivatives."""
        return [place for place, entry in self.entries.items() if dr.grad_enabled(entry.value)]

    def changed(self, item: Any) -> int:
        """When anything in ``item``, a description as it was loaded, last changed; 0 for never."""
        return max((self.entries[p].changed for p in self.below(item)), default=0)

    def moved(self, item: Any) -> int:
        """When anything in ``item`` last changed that surfaces stand by."""
        places = [p for p in self.below(item) if self.entries[p].field.moves_surfaces]
        return max((self.entries[p].changed for p in places), default=0)

    def below(self, item: Any) -> tuple[Place, ...]:
        """The live places in ``item``, those of descriptions that it refers to included."""
        if id(item) not in self._below:
            found = {p: None for p in self.entries if p.owner is item}
            for part in _parts(item):
                found |= dict.fromkeys(self.below(part))
            self._below[id(item)] = tuple(found)
        return self._below[id(item)]

    def current(self, item: Any) -> Any:
        """``item`` with the present values: itself where nothing in it is live, and the same object until something
        changes."""
        if not self.entries or not self.below(item):
            return item
        changed = self.changed(item)
        known = self._current.get(id(item))
        if dr.flag(dr.JitFlag.FreezingScope):
            # Values cannot be looked at: what follows from them is read from buffers.
            return item if known is None else known[1]
        if known is None or known[0] != changed:
            known = self._current[id(item)] = changed, self._made(item), item
        return known[1]

    def _made(self, item: Any) -> Any:
        parts = {f.name: getattr(item, f.name) for f in fields(item)}
        made = {name: self._with_parts(value) for name, value in parts.items()}
        result = replace(item, **{name: value for name, value in made.items() if value is not parts[name]})
        # Where vertices move normals follow, but for those that were set.
        for place in sorted(self.below(item), key=lambda p: p.field == "normals"):
            if place.owner is item:
                entry = self.entries[place]
                result = entry.field.replaced(result, dr.detach(entry.value))
        return result

    def _with_parts(self, value: Any) -> Any:
        if is_dataclass(value):
            return self.current(value)
        if isinstance(value, tuple):
            made = tuple(self._with_parts(v) for v in value)
            return made if any(a is not b for a, b in zip(made, value, strict=True)) else value
        return value


def _parts(item: Any) -> Iterator[Any]:
    """The descriptions that ``item`` refers to directly."""
    for f in fields(item):
        yield from _among(getattr(item, f.name))


def _among(value: Any) -> Iterator[Any]:
    if is_dataclass(value) and not isinstance(value, type):
        yield value
    elif isinstance(value, tuple):
        for v in value:
            if not isinstance(v, str | float | int | np.ndarray):
                yield from _among(v)
