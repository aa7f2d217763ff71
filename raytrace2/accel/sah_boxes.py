"""Boxes as the builder's kernels keep them: packets of eight words that only ever need minima."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..types import Types

#: Words 0 to 2 of a packet are the lower corner and 3 to 5 the *negated* upper one, so that a union is six minima;
#: words 6 and 7 hold integers: a primitive's number, or a node's first primitive and how many it has.
WORDS = 8
FIRST, COUNT = 6, 7


def load(types: Types, buffer: Any, index: Any) -> list[Any]:
    """The eight words of packet ``index``."""
    packet = dr.gather(types.ArrayXf, buffer, index, shape=(WORDS, dr.width(index)))
    return [packet[k] for k in range(WORDS)]


def store(types: Types, buffer: Any, index: Any, words: list[Any]) -> None:
    """Writes up to eight words as packet ``index``; what is missing becomes zero."""
    width = dr.width(index)
    packet = dr.zeros(types.ArrayXf, shape=(WORDS, width))
    for k, word in enumerate(words):
        packet[k] = word
    dr.scatter(buffer, packet, index)


def lanes(types: Types, *columns: np.ndarray) -> list[Any]:
    """UInts with a number of each column (n,) a lane.

    They are read by gathers: direct loads from NumPy's memory would make another kernel for every alignment it happens
    to have, and the row too many keeps Dr.Jit from seeing that the gathers could be loads.
    """
    n = len(columns[0])
    table = np.zeros((n + 1, len(columns)), np.uint32)
    for k, column in enumerate(columns):
        table[:n, k] = column
    source, row = types.UInt(table.ravel()), dr.arange(types.UInt, n)
    return [dr.gather(types.UInt, source, row * len(columns) + k) for k in range(len(columns))]


def encode_integer(types: Types, value: Any) -> Any:
    """A UInt as the Float that :func:`raytrace2.surfaces.record.decode_integer` takes back."""
    return dr.reinterpret_array(types.Float, value) if types.precision == "float32" else types.Float(value)


def centre(box: list[Any]) -> list[Any]:
    """The middle of a box, halved before it is added so that it cannot overflow."""
    return [box[k] * 0.5 - box[k + 3] * 0.5 for k in range(3)]


def union(a: list[Any], b: list[Any], active: Any = None) -> list[Any]:
    """The box around ``a`` and, where ``active``, ``b``."""
    both = [dr.fmin(x, y) for x, y in zip(a[:6], b[:6], strict=True)]
    return both if active is None else [dr.select(active, u, x) for u, x in zip(both, a[:6], strict=True)]


def area(box: list[Any], unit: Any) -> Any:
    """Half the surface area in units of ``1 / unit**2``; zero for an empty box."""
    x, y, z = (dr.fmax((-box[k + 3] - box[k]) * unit, 0) for k in range(3))
    return x * y + y * z + z * x


def empty(types: Types, width: int) -> list[Any]:
    """The box around nothing, for ``width`` lanes."""
    return [dr.full(types.Float, dr.inf, width) for _ in range(6)]


@dataclass(frozen=True, eq=False)
class Group:
    """The primitives ``begin`` to ``end`` (excluded) of a node, a node a lane: ``least`` and ``scale`` map a middle to
    bins on each axis, ``unit`` brings the node's largest side to one, so that areas neither overflow nor vanish."""

    begin: Any
    end: Any
    least: list[Any]
    scale: list[Any]
    unit: Any


def group_of(types: Types, bounds: list[Any], middles: list[Any], begin: Any, end: Any, bins: int) -> Group:
    """The group of a node with ``bounds``, and ``middles`` the box around its primitives' middles."""
    size = dr.fmax(dr.fmax(-bounds[3] - bounds[0], -bounds[4] - bounds[1]), -bounds[5] - bounds[2])
    scale = [_reciprocal(types, -middles[k + 3] - middles[k], bins) for k in range(3)]
    return Group(begin, end, middles[:3], scale, _reciprocal(types, size, 1))


def _reciprocal(types: Types, size: Any, numerator: int) -> Any:
    """``numerator / size``, kept finite; zero where the size is zero or no number."""
    return dr.select(size > 0, dr.fmin(numerator / size, types.largest), 0)
