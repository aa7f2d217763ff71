"""What a ray query returns, and the record of the closest hit so far that a traversal carries."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr


@dataclass
class Hit:
    """The closest hit of each ray, enough for ``interact`` to find everything else.

    ``t`` Float, inf on a miss; ``prim`` UInt, index within the surface; ``uv`` Array2f, barycentric weights of
    vertices 1 and 2 on triangles, local coordinates on rectangles and disks; ``surface`` UInt, index of the surface
    in the structure (the order they were given in, groups flattened); ``instance`` UInt. On a miss the three indices
    are 0xFFFFFFFF.
    """

    t: Any
    prim: Any
    uv: Any
    surface: Any
    instance: Any

    @property
    def valid(self) -> Any:
        """Bool: whether the ray met anything."""
        return self.surface != 0xFFFFFFFF

    def is_valid(self) -> Any:
        """The same as :attr:`valid`, as Mitsuba spells it."""
        return self.valid


@dataclass
class Counts:
    """What a query cost each ray, nested structures included: UInt numbers of bounding ``volumes`` tested, of ``nodes``
    (or cells) visited and of ``primitives`` tested."""

    volumes: Any
    nodes: Any
    primitives: Any


@dataclass
class Candidate:
    """The best hit so far inside a traversal: ``t`` (the largest allowed t before any hit), two surface coordinates,
    the primitive's number ``id`` in the structure, and that of the instance it was met through (None without
    instances). ``counts`` is None unless someone asked: then nothing of it is in the kernel."""

    t: Any
    u: Any
    v: Any
    id: Any
    instance: Any
    counts: Any = None

    def counted(self, where: Any = True, *, volumes: Any = 0, nodes: Any = 0, primitives: Any = 0) -> Candidate:
        """The same with these numbers added to the counts of the lanes ``where``, if counts are kept."""
        if self.counts is None:
            return self
        c = self.counts

        def more(old: Any, new: Any) -> Any:
            return old + dr.select(where, type(old)(new), 0)

        counts = Counts(more(c.volumes, volumes), more(c.nodes, nodes), more(c.primitives, primitives))
        return replace(self, counts=counts)
