"""Bins of nodes with many references, filled by several lanes a node."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from ..surfaces.record import decode_integer, encode_integers
from ..types import Types
from .sah_bins import ALL_BINS
from .sah_boxes import COUNT, FIRST, WORDS, encode_integer, lanes, load, store
from .sah_split_large import Chunks
from .spatial_bins import CutBins, fill_cut_bins, no_cut_bins


def cut_bins_by_chunks(types: Types, packets: Any, corners: Any, bounds: list[Any], chunks: Chunks) -> CutBins:
    """What :func:`fill_cut_bins` gives for nodes with ``bounds``, to the bit, with a lane a chunk."""
    UInt, n, m = types.UInt, len(chunks.owner), len(chunks.first)
    owner, begin, end = lanes(types, chunks.owner, chunks.begin, chunks.end)
    mine = [dr.gather(types.Float, b, owner) for b in bounds]
    table = dr.empty(types.Float, n * ALL_BINS * WORDS)
    row = dr.arange(UInt, n) * ALL_BINS

    def write(k: Any, boxes: Any, entries: Any, exits: Any) -> tuple[Any, ...]:
        words = [boxes.read(k * 6 + j) for j in range(6)]
        numbers = [encode_integer(types, x.read(k)) for x in (entries, exits)]
        store(types, table, row + k, [*words, *numbers])
        return k + 1, boxes, entries, exits

    state = (dr.zeros(UInt, n), *fill_cut_bins(types, packets, corners, mine, begin, end))
    dr.while_loop(state, lambda k, *_: k < ALL_BINS, write, label="store cut bins")
    dr.eval(table)
    parts = table.numpy().reshape(n, ALL_BINS, WORDS)
    whole = chunks.joined(parts)
    numbers = np.ascontiguousarray(parts[..., FIRST:])
    numbers = numbers.view(np.uint32) if types.precision == "float32" else numbers
    whole[..., FIRST:] = encode_integers(np.add.reduceat(numbers.astype(np.int64), chunks.first, axis=0), types)
    source = types.Float(whole.ravel())
    place = dr.arange(UInt, m) * ALL_BINS

    def read(k: Any, boxes: Any, entries: Any, exits: Any) -> tuple[Any, ...]:
        words = load(types, source, place + k)
        for j in range(6):
            boxes.write(words[j], k * 6 + j)
        entries.write(decode_integer(words[FIRST], types), k)
        exits.write(decode_integer(words[COUNT], types), k)
        return k + 1, boxes, entries, exits

    start = (dr.zeros(UInt, m), *no_cut_bins(types))
    _, boxes, entries, exits = dr.while_loop(start, lambda k, *_: k < ALL_BINS, read, label="load cut bins")
    return boxes, entries, exits
