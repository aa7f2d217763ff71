"""Rays through a flat list of volumes, a chapter at a time: first which volumes are met, then the primitives of those.

All rays go down the list in step, so that rays that a processor works on at once read the same volumes, and each
notes what it met. Then each works through its own notes: rays that met different groups test them at the same time,
where testing a group as soon as any of them met it would make all the others wait.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..surfaces.hit import Candidate
from ..surfaces.primitives import DevicePrimitives, LocalRay
from ..types import Types
from .volumes import Volume, VolumeRay

#: Volumes tested a turn: a note tells which of a block were met.
BLOCK = 4
#: Blocks in a chapter: as many notes can be pending.
CHAPTER = 64
#: Most volumes there can be, for a note to hold a block's number.
MAX_VOLUMES = 2**30
#: Words gathered at a time.
_PACKET = 16


@dataclass(frozen=True, eq=False)
class DeviceVolumes:
    """``words`` of the volumes, padded to whole blocks; ``ranges``, first primitive and end of each; ``count`` of
    volumes."""

    types: Types
    volume: Volume
    words: Any
    ranges: Any
    count: Any
    primitives: DevicePrimitives


@dataclass
class Notes:
    """What a ray has still to test: the met blocks in ``blocks`` (``size`` of them), the volumes ``mask`` of the
    block ``base``, and the primitives from ``i`` to ``end`` of a volume."""

    blocks: Any
    size: Any
    base: Any
    mask: Any
    i: Any
    end: Any


def padded(words: np.ndarray) -> np.ndarray:
    """``words`` (groups, width) with rows of zeros up to a whole number of blocks, which nobody asks about."""
    return np.pad(words, ((0, -len(words) % BLOCK), (0, 0)))


def ranges(firsts: np.ndarray) -> np.ndarray:
    """First primitive and end of each group (groups, 2)."""
    return np.stack([firsts[:-1], firsts[1:]], axis=1).astype(np.uint32)


def closest(device: DeviceVolumes, ray: LocalRay, best: Candidate, active: Any) -> Candidate:
    """The closest hit no farther than ``best.t``."""
    ready, volume_ray = device.primitives.prepare(ray), device.volume.prepare(ray, device.types)

    def pick(notes: Notes, best: Candidate) -> tuple[Notes, Candidate]:
        return _next_group(device, volume_ray, notes, best.t), best.counted(volumes=1)

    def test(notes: Notes, best: Candidate) -> tuple[Notes, Candidate]:
        best = device.primitives.intersect_one(notes.i, ready, best)
        notes.i = notes.i + 1
        return notes, best

    def turn(notes: Notes, best: Candidate) -> tuple[Notes, Candidate]:
        notes, best = dr.if_stmt((notes, best), notes.i >= notes.end, pick, lambda *s: s)
        return dr.if_stmt((notes, best), notes.i < notes.end, test, lambda *s: s)

    def chapter(base: Any, end: Any, best: Candidate) -> tuple[Any, Any, Candidate]:
        after, notes = _read_chapter(device, volume_ray, base, end, best.t)
        best = best.counted(volumes=after - base)
        _, best = dr.while_loop(
            (notes, best), lambda notes, _: _unfinished(notes), turn, label="bounding volumes primitives"
        )
        return after, end, best

    zero = dr.zeros(device.types.UInt, dr.width(best.t))
    state = (zero, dr.select(active, device.count, 0) + zero, best)
    return dr.while_loop(state, lambda base, end, _: base < end, chapter, label="bounding volumes closest")[-1]


def anything(device: DeviceVolumes, ray: LocalRay, root: Any, active: Any) -> Any:
    """Bool: whether each ray meets anything between its tmin and tmax."""
    ready, volume_ray = device.primitives.prepare(ray), device.volume.prepare(ray, device.types)

    def pick(notes: Notes, blocked: Any) -> tuple[Notes, Any]:
        return _next_group(device, volume_ray, notes, None), blocked

    def test(notes: Notes, blocked: Any) -> tuple[Notes, Any]:
        blocked = blocked | device.primitives.occludes_one(notes.i, ready)
        notes.i = notes.i + 1
        return notes, blocked

    def turn(notes: Notes, blocked: Any) -> tuple[Notes, Any]:
        notes, blocked = dr.if_stmt((notes, blocked), notes.i >= notes.end, pick, lambda *s: s)
        return dr.if_stmt((notes, blocked), notes.i < notes.end, test, lambda *s: s)

    def chapter(base: Any, end: Any, blocked: Any) -> tuple[Any, Any, Any]:
        base, notes = _read_chapter(device, volume_ray, base, end, ray.tmax)
        _, blocked = dr.while_loop(
            (notes, blocked),
            lambda notes, blocked: _unfinished(notes) & ~blocked,
            turn,
            label="bounding volumes any primitive",
        )
        return base, dr.select(blocked, 0, end), blocked

    zero = dr.zeros(device.types.UInt, dr.width(root))
    blocked = dr.full(device.types.Bool, False, dr.width(root))
    state = (zero, dr.select(active, device.count, 0) + zero, blocked)
    return dr.while_loop(state, lambda base, end, _: base < end, chapter, label="bounding volumes anything")[-1]


def _read_chapter(device: DeviceVolumes, ray: VolumeRay, base: Any, end: Any, tmax: Any) -> tuple[Any, Notes]:
    """The first volume after the chapter that begins at ``base``, and notes on the volumes in it that each ray
    meets."""
    UInt, width = device.types.UInt, dr.width(base)
    stop = base + BLOCK * CHAPTER
    stop = dr.select(stop < end, stop, end)

    def read(base: Any, stop: Any, blocks: Any, size: Any) -> tuple[Any, ...]:
        mask = _met(device, ray, base, tmax)
        some = mask != 0
        # Blocks begin at multiples of four, and a block's mask has as many bits.
        blocks.write((base << 2) | mask, size, some)
        return base + BLOCK, stop, blocks, dr.select(some, size + 1, size)

    state = (base, stop, dr.alloc_local(UInt, CHAPTER), dr.zeros(UInt, width))
    base, _, blocks, size = dr.while_loop(
        state, lambda base, stop, *_: base < stop, read, label="bounding volumes chapter"
    )
    zero = dr.zeros(UInt, width)
    return dr.select(base < end, base, end), Notes(blocks, size, zero, zero + 0, zero + 0, zero + 0)


def _unfinished(notes: Notes) -> Any:
    return (notes.i < notes.end) | (notes.mask != 0) | (notes.size != 0)


def _next_group(device: DeviceVolumes, ray: VolumeRay, notes: Notes, tmax: Any) -> Notes:
    """Goes on to the next volume in the notes, and to its primitives; not if a ``tmax`` is given that now ends before
    it."""
    UInt = device.types.UInt
    turn_page = notes.mask == 0
    size = dr.select(turn_page, notes.size - 1, notes.size)
    note = notes.blocks.read(size, turn_page)
    base = dr.select(turn_page, (note >> BLOCK) << 2, notes.base)
    mask = dr.select(turn_page, note & (2**BLOCK - 1), notes.mask)
    group = base + dr.tzcnt(mask)
    span = dr.gather(device.types.Array2u, device.ranges, group)
    end = span.y
    if tmax is not None:
        width = device.volume.width
        words = dr.gather(device.types.ArrayXf, device.words, group, shape=(width, dr.width(group)))
        end = dr.select(device.volume.meets([words[m] for m in range(width)], ray, tmax), end, span.x)
    return Notes(notes.blocks, size, base, mask & (mask - UInt(1)), span.x, end)


def _met(device: DeviceVolumes, ray: VolumeRay, base: Any, tmax: Any) -> Any:
    """A bit for each volume of the block from ``base`` on that its ray meets."""
    types, width = device.types, device.volume.width
    packet = min(_PACKET, width * BLOCK)
    per_packet = packet // width
    mask = types.UInt(0)
    for k in range(0, BLOCK, per_packet):
        index = (base + k) // per_packet if per_packet > 1 else base + k
        gathered = dr.gather(types.ArrayXf, device.words, index, shape=(packet, dr.width(base)))
        for j in range(per_packet):
            words = [gathered[width * j + m] for m in range(width)]
            hit = device.volume.meets(words, ray, tmax) & (base + (k + j) < device.count)
            mask |= dr.select(hit, types.UInt(1 << (k + j)), types.UInt(0))
    return mask
