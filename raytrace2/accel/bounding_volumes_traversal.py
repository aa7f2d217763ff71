"""Rays through a flat list of volumes, a chapter at a time: first which volumes are met, then the primitives of those.

All rays go down the list in step, so that rays that a processor works on at once read the same volumes, and each
notes what it met. Then each works through its own notes: rays that met different groups test them at the same time,
where testing a group as soon as any of them met it would make all the others wait.

Reading takes a turn for each block, and working through the notes a turn for each volume or primitive: whatever the
tests say, a ray comes to none twice, so it takes no more turns of the inner loops than there are of all three.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..surfaces.hit import Candidate
from ..surfaces.primitives import DevicePrimitives, LocalRay
from ..surfaces.turns import Turns, after_turn, goes_on
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


def most_turns(volumes: int, primitives: int) -> int:
    """The most turns that a ray can take, in all."""
    return -(-volumes // BLOCK) + volumes + primitives


def closest(device: DeviceVolumes, ray: LocalRay, best: Candidate, active: Any, turns: Turns) -> Candidate:
    """The closest hit no farther than ``best.t``."""
    ready, volume_ray = device.primitives.prepare(ray), device.volume.prepare(ray, device.types)

    def pick(notes: Notes, best: Candidate) -> tuple[Notes, Candidate]:
        return _next_group(device, volume_ray, notes, best.t), best.counted(volumes=1)

    def test(notes: Notes, best: Candidate) -> tuple[Notes, Candidate]:
        best = device.primitives.intersect_one(notes.i, ready, best)
        notes.i = notes.i + 1
        return notes, best

    def turn(notes: Notes, left: Any, best: Candidate) -> tuple[Notes, Any, Candidate]:
        notes, best = dr.if_stmt((notes, best), notes.i >= notes.end, pick, lambda *s: s)
        notes, best = dr.if_stmt((notes, best), notes.i < notes.end, test, lambda *s: s)
        return notes, after_turn(left), best

    def chapter(base: Any, end: Any, left: Any, best: Candidate) -> tuple[Any, Any, Any, Candidate]:
        after, left, notes = _read_chapter(device, volume_ray, base, end, left, best.t)
        best = best.counted(volumes=after - base)
        notes, left, best = dr.while_loop(
            (notes, left, best),
            lambda notes, left, _: goes_on(_unfinished(notes), left),
            turn,
            label="bounding volumes primitives",
        )
        turns.note(_unfinished(notes), left)
        return after, end, left, best

    zero = dr.zeros(device.types.UInt, dr.width(best.t))
    left = turns.left(dr.width(best.t), best.counts is not None)
    state = (zero, dr.select(active, device.count, 0) + zero, left, best)
    base, end, left, best = dr.while_loop(
        state,
        lambda base, end, left, _: goes_on(base < end, left),
        chapter,
        label="bounding volumes closest",
    )
    turns.note(base < end, left)
    return best


def anything(device: DeviceVolumes, ray: LocalRay, root: Any, active: Any, turns: Turns) -> Any:
    """Bool: whether each ray meets anything between its tmin and tmax."""
    ready, volume_ray = device.primitives.prepare(ray), device.volume.prepare(ray, device.types)

    def pick(notes: Notes, blocked: Any) -> tuple[Notes, Any]:
        return _next_group(device, volume_ray, notes, None), blocked

    def test(notes: Notes, blocked: Any) -> tuple[Notes, Any]:
        blocked = blocked | device.primitives.occludes_one(notes.i, ready)
        notes.i = notes.i + 1
        return notes, blocked

    def turn(notes: Notes, left: Any, blocked: Any) -> tuple[Notes, Any, Any]:
        notes, blocked = dr.if_stmt((notes, blocked), notes.i >= notes.end, pick, lambda *s: s)
        notes, blocked = dr.if_stmt((notes, blocked), notes.i < notes.end, test, lambda *s: s)
        return notes, after_turn(left), blocked

    def chapter(base: Any, end: Any, left: Any, blocked: Any) -> tuple[Any, Any, Any, Any]:
        base, left, notes = _read_chapter(device, volume_ray, base, end, left, ray.tmax)
        notes, left, blocked = dr.while_loop(
            (notes, left, blocked),
            lambda notes, left, blocked: goes_on(_unfinished(notes) & ~blocked, left),
            turn,
            label="bounding volumes any primitive",
        )
        turns.note(_unfinished(notes) & ~blocked, left)
        return base, dr.select(blocked, 0, end), left, blocked

    width = dr.width(root)
    zero = dr.zeros(device.types.UInt, width)
    blocked = dr.full(device.types.Bool, False, width)
    state = (zero, dr.select(active, device.count, 0) + zero, turns.left(width, False), blocked)
    base, end, left, blocked = dr.while_loop(
        state,
        lambda base, end, left, _: goes_on(base < end, left),
        chapter,
        label="bounding volumes anything",
    )
    turns.note(base < end, left)
    return blocked


def _read_chapter(
    device: DeviceVolumes, ray: VolumeRay, base: Any, end: Any, left: Any, tmax: Any
) -> tuple[Any, Any, Notes]:
    """The first volume after the chapter that begins at ``base``, the turns left, and notes on the volumes in it that
    each ray meets."""
    UInt, width = device.types.UInt, dr.width(base)
    stop = base + BLOCK * CHAPTER
    stop = dr.select(stop < end, stop, end)

    def read(base: Any, stop: Any, blocks: Any, size: Any, left: Any) -> tuple[Any, ...]:
        mask = _met(device, ray, base, tmax)
        some = mask != 0
        # Blocks begin at multiples of four, and a block's mask has as many bits.
        blocks.write((base << 2) | mask, size, some)
        return base + BLOCK, stop, blocks, dr.select(some, size + 1, size), after_turn(left)

    state = (base, stop, dr.alloc_local(UInt, CHAPTER), dr.zeros(UInt, width), left)
    base, _, blocks, size, left = dr.while_loop(
        state,
        lambda base, stop, blocks, size, left: goes_on(base < stop, left),
        read,
        label="bounding volumes chapter",
    )
    zero = dr.zeros(UInt, width)
    return dr.select(base < end, base, end), left, Notes(blocks, size, zero, zero + 0, zero + 0, zero + 0)


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
