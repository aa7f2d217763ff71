"""One bounce written down, and done again from that without a traversal or a random number."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import drjit as dr

from ...rays.differentials import Differentials, Meeting
from ...rays.footprint import Footprint
from ...rays.ray import Ray
from ...surfaces.hit import Hit
from ...types import Types
from ..tracing import Tracing


@dataclass
class Span:
    """A :class:`Footprint` as a memory holds it; what is None there is so here."""

    dx: Any
    dy: Any
    dxx: Any
    dxy: Any
    dyy: Any
    flags: Any

    def footprint(self) -> Footprint:
        """The footprint, with nothing looked up."""
        return Footprint(self.dx, self.dy, self.dxx, self.dxy, self.dyy, flags=self.flags)


@dataclass
class Memory:
    """All that was told from outside, in order: hits, the numbers drawn, whether shadow rays were blocked, and
    footprints."""

    hits: list[Any] = field(default_factory=list)
    drawn: list[Any] = field(default_factory=list)
    blocked: list[Any] = field(default_factory=list)
    spans: list[Any] = field(default_factory=list)


class Recorder:
    """Stands for the tracing, the sampler and the differentials of a bounce, and remembers what they said."""

    keeps_gradients = False
    follows_black = True
    holds_directions = False

    def __init__(self, tracing: Tracing, sampler: Any, differentials: Differentials) -> None:
        self._tracing, self._sampler, self._differentials = tracing, sampler, differentials
        self.memory = Memory()

    def closest(self, ray: Ray, active: Any, hidden: Any) -> Hit:
        self.memory.hits.append(self._tracing.closest(ray, active, hidden))
        return self.memory.hits[-1]

    def blocked(self, ray: Ray, active: Any) -> Any:
        self.memory.blocked.append(self._tracing.blocked(ray, active))
        return self.memory.blocked[-1]

    def next_1d(self, active: Any = True) -> Any:
        self.memory.drawn.append(self._sampler.next_1d(active))
        return self.memory.drawn[-1]

    def next_2d(self, active: Any = True) -> Any:
        self.memory.drawn.append(self._sampler.next_2d(active))
        return self.memory.drawn[-1]

    def meet(self, structure: Any, ray: Ray, state: Any, hit: Hit) -> Meeting:
        meeting = self._differentials.meet(structure, ray, state, hit)
        seen = meeting.si.footprint
        if seen is not None:
            span = Span(seen.dx, seen.dy, seen.dxx, seen.dxy, seen.dyy, seen.flags)
            self.memory.spans.append(dr.detach(span))
        return meeting

    def leave(self, meeting: Meeting, sample: Any, ray: Ray, state: Any) -> Any:
        return self._differentials.leave(meeting, sample, ray, state)


class Nothing:
    """A tracing and a sampler that say nothing: to find out what a bounce asks, without asking."""

    keeps_gradients = False
    follows_black = True
    holds_directions = False

    def __init__(self, types: Types) -> None:
        self._types = types

    def closest(self, ray: Ray, active: Any, hidden: Any) -> Hit:
        t = self._types
        return Hit(t.Float(0), t.UInt(0), t.Array2f(0), t.UInt(0), t.UInt(0))

    def blocked(self, ray: Ray, active: Any) -> Any:
        return self._types.Bool(False)

    def next_1d(self, active: Any = True) -> Any:
        return self._types.Float(0)

    def next_2d(self, active: Any = True) -> Any:
        return self._types.Array2f(0)


class Player:
    """Says what a :class:`Recorder` heard. Interactions are computed from the ray anew, with derivatives where it or
    the scene has them; footprints are as remembered, with the derivatives of ``differentials`` if given; ``holds``,
    where smooth lobes send paths stays where it is."""

    keeps_gradients = True
    follows_black = True

    def __init__(self, memory: Memory, differentials: Differentials | None = None, holds: bool = False) -> None:
        self._differentials, self.holds_directions = differentials, holds
        self._hits: Iterator[Any] = iter(memory.hits)
        self._drawn: Iterator[Any] = iter(memory.drawn)
        self._blocked: Iterator[Any] = iter(memory.blocked)
        self._spans: Iterator[Any] = iter(memory.spans)

    def closest(self, ray: Ray, active: Any, hidden: Any) -> Hit:
        return next(self._hits)

    def blocked(self, ray: Ray, active: Any) -> Any:
        return next(self._blocked)

    def next_1d(self, active: Any = True) -> Any:
        return next(self._drawn)

    def next_2d(self, active: Any = True) -> Any:
        return next(self._drawn)

    def meet(self, structure: Any, ray: Ray, state: Any, hit: Hit) -> Meeting:
        span = next(self._spans, None)
        if self._differentials is None:
            si = structure.interact(ray, hit)
            si.footprint = None if span is None else span.footprint()
            return Meeting(si, si)
        meeting = self._differentials.meet(structure, ray, state, hit)
        assert span is not None
        moving = meeting.si.footprint
        moving.dx, moving.dy = dr.replace_grad(span.dx, moving.dx), dr.replace_grad(span.dy, moving.dy)
        moving.dxx, moving.dxy, moving.dyy, moving.flags = span.dxx, span.dxy, span.dyy, span.flags
        return meeting

    def leave(self, meeting: Meeting, sample: Any, ray: Ray, state: Any) -> Any:
        return state if self._differentials is None else self._differentials.leave(meeting, sample, ray, state)
