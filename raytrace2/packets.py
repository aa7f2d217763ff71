"""Arrays of small records in memory: a lane's numbers side by side, moved a packet of up to four at a time."""

from __future__ import annotations

from typing import Any

import drjit as dr

from .types import Types


def store_packets(types: Types, values: list[Any], count: int) -> list[Any]:
    """Buffers, being evaluated, that hold ``values`` (Floats of width ``count`` or 1), record after record."""
    if count * 4 >= 2**32:
        raise ValueError(f"{count} records are too many for one buffer")
    lane = dr.arange(types.UInt, count)
    buffers = []
    for start, kind in _groups(types, len(values)):
        size = dr.size_v(kind) if kind is not types.Float else 1
        buffer = dr.empty(types.Float, count * size)
        dr.scatter(buffer, kind(*values[start : start + size]), lane)
        buffers.append(buffer)
    dr.eval(buffers)
    return buffers


def load_packets(types: Types, buffers: list[Any], fields: int, index: Any, active: Any = True) -> list[Any]:
    """The ``fields`` Floats of record ``index``, zeros where not ``active``."""
    values: list[Any] = []
    for buffer, (_, kind) in zip(buffers, _groups(types, fields), strict=True):
        packet = dr.gather(kind, buffer, index, active)
        values.extend([packet] if kind is types.Float else packet)
    return values


def _groups(types: Types, fields: int) -> list[tuple[int, Any]]:
    """First field and array type of each packet that ``fields`` fields are moved in."""
    groups = []
    start = 0
    while start < fields:
        size, kind = next(
            (size, kind)
            for size, kind in ((4, types.Array4f), (2, types.Array2f), (1, types.Float))
            if size <= fields - start
        )
        groups.append((start, kind))
        start += size
    return groups
