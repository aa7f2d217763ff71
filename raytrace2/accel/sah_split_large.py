"""Splitting nodes large enough to be shared by many lanes, a chunk of primitives each."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import numpy as np

from ..surfaces.record import decode_integer, encode_integers
from ..types import Types
from .sah_bins import ALL_BINS, BINS, BY_COUNT, add_to_bin, cheapest_plane, fill_bins, no_bins
from .sah_boxes import COUNT, FIRST, WORDS, encode_integer, lanes, load, store
from .sah_level import Level, right_of_plane
from .sah_partition import partition, store_children


@dataclass(frozen=True, eq=False)
class Chunks:
    """Ranges of primitives: chunk k belongs to the node numbered ``owner[k]`` of those being split, whose first chunk
    is ``first[owner[k]]``."""

    owner: np.ndarray
    first: np.ndarray
    begin: np.ndarray
    end: np.ndarray

    @staticmethod
    def of(begin: np.ndarray, count: np.ndarray, size: int) -> Chunks:
        """Chunks of ``size`` primitives over nodes of ``count`` primitives from ``begin`` on."""
        number = -(-count // size)
        owner = np.repeat(np.arange(len(count)), number)
        first = np.cumsum(number) - number
        start = begin[owner] + size * (np.arange(len(owner)) - first[owner])
        return Chunks(owner, first, start, np.minimum(start + size, (begin + count)[owner]))

    def joined(self, packets: np.ndarray) -> np.ndarray:
        """For each node the boxes around its chunks' packets (n, ..., 8); the integer words are left zero."""
        whole = np.zeros((len(self.first), *packets.shape[1:]), packets.dtype)
        np.minimum.reduceat(packets[..., :FIRST], self.first, axis=0, out=whole[..., :FIRST])
        return whole


def split_large(
    level: Level, node: np.ndarray, place: np.ndarray, begin: np.ndarray, count: np.ndarray, size: int
) -> None:
    """Splits nodes ``node``, of ``count`` primitives from ``begin`` on, by lanes that take ``size`` primitives each;
    their children become nodes ``place`` and ``place + 1`` of the next level."""
    types = level.types
    chunks = Chunks.of(begin, count, size)
    bins = _bins_of_chunks(level, node, chunks)
    counts = _integers(bins[..., COUNT], types)
    whole = chunks.joined(bins)
    whole[..., COUNT] = encode_integers(np.add.reduceat(counts, chunks.first), types)
    axis, plane = _choose(level, node, whole)

    half = begin + count // 2
    left_bins = (np.arange(3)[:, None] == axis[:, None, None]) & (np.arange(BINS) < plane[:, None, None])
    lefts = (counts * left_bins.reshape(-1, ALL_BINS)[chunks.owner]).sum(axis=1)
    halved = np.clip(half[chunks.owner] - chunks.begin, 0, chunks.end - chunks.begin)
    lefts = np.where(axis[chunks.owner] == BY_COUNT, halved, lefts)
    before = np.cumsum(lefts) - lefts
    before -= before[chunks.first][chunks.owner]
    left_at = begin[chunks.owner] + before
    right_at = (begin + count)[chunks.owner] - 1 - (chunks.begin - left_at)
    bounds, middles = _move_chunks(level, node, chunks, (axis, plane, half), left_at, right_at)

    number = np.add.reduceat(lefts, chunks.first)
    nodes = chunks.joined(bounds)
    nodes[..., FIRST] = encode_integers(np.stack([begin, begin + number], axis=1), types)
    nodes[..., COUNT] = encode_integers(np.stack([number, count - number], axis=1), types)
    places = np.stack([place, place + 1], axis=1).ravel()
    _store_rows(types, level.next_nodes, places, nodes)
    _store_rows(types, level.next_middles, places, chunks.joined(middles))


def _bins_of_chunks(level: Level, node: np.ndarray, chunks: Chunks) -> np.ndarray:
    """Each chunk's bins as packets (n, ALL_BINS, 8), counts in their last word."""
    types, n = level.types, len(chunks.owner)
    UInt = types.UInt
    owner, begin, end = lanes(types, node[chunks.owner], chunks.begin, chunks.end)
    group = replace(level.group(owner), begin=begin, end=end)
    packets = dr.empty(types.Float, n * ALL_BINS * WORDS)
    first = dr.arange(UInt, n) * ALL_BINS

    def write(k: Any, boxes: Any, counts: Any) -> tuple[Any, ...]:
        words = [boxes.read(k * 6 + j) for j in range(6)]
        store(types, packets, first + k, [*words, types.Float(0), encode_integer(types, counts.read(k))])
        return k + 1, boxes, counts

    state = (dr.zeros(UInt, n), *fill_bins(types, level.primitives, group))
    dr.while_loop(state, lambda k, *_: k < ALL_BINS, write, label="store bins")
    dr.eval(packets)
    return packets.numpy().reshape(n, ALL_BINS, WORDS)


def _choose(level: Level, node: np.ndarray, bins: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The axis and the plane of each node with bins (m, ALL_BINS, 8)."""
    types, m = level.types, len(node)
    UInt = types.UInt
    packets = types.Float(bins.ravel())
    first = dr.arange(UInt, m) * ALL_BINS

    def read(k: Any, boxes: Any, counts: Any) -> tuple[Any, ...]:
        words = load(types, packets, first + k)
        add_to_bin((boxes, counts), k, words, decode_integer(words[COUNT], types))
        return k + 1, boxes, counts

    state = (dr.zeros(UInt, m), *no_bins(types))
    _, boxes, counts = dr.while_loop(state, lambda k, *_: k < ALL_BINS, read, label="load bins")
    group = level.group(*lanes(types, node))
    axis, plane, _ = cheapest_plane(types, (boxes, counts), group.end - group.begin, group.unit)
    axis = level.chosen(axis)
    dr.eval(axis, plane)
    return axis.numpy().astype(np.int64), plane.numpy().astype(np.int64)


def _move_chunks(
    level: Level,
    node: np.ndarray,
    chunks: Chunks,
    split: tuple[np.ndarray, ...],
    left_at: np.ndarray,
    right_at: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Partitions every chunk; gives the boxes around both sides and around their middles, (n, 2, 8) each."""
    types, n = level.types, len(chunks.owner)
    UInt, Float = types.UInt, types.Float
    columns = (node, *split)
    owner, axis, plane, half = lanes(types, *(c[chunks.owner] for c in columns))
    begin, end, left, right = lanes(types, chunks.begin, chunks.end, left_at, right_at)
    group = level.group(owner)
    is_right = right_of_plane(types, axis, Float(plane), group.least, group.scale, half)
    sides, left_end = partition(types, level.primitives, level.next_primitives, begin, end, left, right, is_right)
    bounds, middles = dr.empty(Float, n * 2 * WORDS), dr.empty(Float, n * 2 * WORDS)
    store_children(types, bounds, middles, dr.arange(UInt, n) * 2, sides, begin, left_end, end)
    dr.eval(bounds, middles, level.next_primitives)
    return bounds.numpy().reshape(n, 2, WORDS), middles.numpy().reshape(n, 2, WORDS)


def _integers(words: np.ndarray, types: Types) -> np.ndarray:
    words = np.ascontiguousarray(words)
    return (words.view(np.uint32) if types.precision == "float32" else words).astype(np.int64)


def _store_rows(types: Types, buffer: Any, index: np.ndarray, rows: np.ndarray) -> None:
    (places,) = lanes(types, index)
    words = load(types, types.Float(rows.ravel()), dr.arange(types.UInt, len(index)))
    store(types, buffer, places, words)
