"""How the blocks along one side of an image follow from its texels, or from the blocks of the level before.

A side of n texels has ceil(n / 2^level) equal blocks on each ``level`` from 1 on. Where that is half the number before,
a block is made of two; else its ends lie elsewhere, and it is integrated anew.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .wrap import CLAMP, REPEAT


@dataclass(frozen=True)
class Side:
    """One side of an image on one level: ``length`` texels in ``count`` blocks of ``size`` texels each.

    ``ended``: there was one block before already. Then a clamped side stays as it is, and others (``flat``) are taken
    for twice as many periods, without a slope. ``halves``: blocks are pairs of the level before, or those themselves.
    """

    length: int
    count: int
    size: float
    ended: bool
    halves: bool
    clamped: bool
    nearest: bool
    mode: int

    @property
    def flat(self) -> bool:
        """Whether the slope is taken for 0."""
        return self.ended and not self.clamped

    @property
    def stored(self) -> int:
        """Blocks in memory: clamped sides have one more at either end."""
        return self.count + 2 * self.clamped


def halvings(size: int) -> int:
    """The level on which ``size`` texels are one block."""
    return max(0, size - 1).bit_length()


def side(length: int, level: int, mode: int, nearest: bool) -> Side:
    """A side on ``level``, from 1 on."""
    count = -(-length // 2**level)
    beyond = max(0, level - halvings(length))
    clamped = mode == CLAMP
    return Side(
        length,
        count,
        length * (1.0 if clamped else 2.0**beyond) / count,
        beyond > 0,
        level > 1 and (beyond > 0 or 2 * count == -(-length // 2 ** (level - 1))),
        clamped,
        nearest,
        mode,
    )


@dataclass(frozen=True)
class Taps:
    """Blocks as sums over texels: block k reads ``texels[first[k]]`` and those that follow, as many as ``mean``
    (blocks, taps) has columns.

    ``mean`` and ``slope`` weigh texels; the mean of the square has ``square`` for each texel's square, and twice
    ``cross`` for its product with the texel before.
    """

    texels: np.ndarray
    first: np.ndarray
    mean: np.ndarray
    slope: np.ndarray
    square: np.ndarray
    cross: np.ndarray


def texel_taps(side: Side) -> Taps:
    """The blocks of a side from its texels."""
    n, size = side.length, side.length / side.count
    ends = np.arange(side.count + 1) * size + (0.0 if side.nearest else 0.5)
    first = np.floor(ends[:-1]).astype(np.int64)
    cells = int((np.ceil(ends[1:]) - first).max())
    cell = first[:, None] + np.arange(cells)
    low, high = np.clip(ends[:-1, None] - cell, 0, 1), np.clip(ends[1:, None] - cell, 0, 1)
    middle = (ends[:-1, None] + ends[1:, None]) / 2 - cell
    p1, p2, p3 = high - low, (high**2 - low**2) / 2, (high**3 - low**3) / 3
    if side.nearest:
        mean, slope, square, cross = p1, p2 - middle * p1, p1, np.zeros_like(p1)
        texels = np.arange(n)
    else:
        # Cell k runs from texel k - 1 to texel k of the image.
        mean = _joined(p1 - p2, p2)
        slope = _joined(p2 - p3 - middle * (p1 - p2), p3 - middle * p2)
        square, cross = _joined(p1 - 2 * p2 + p3, p3), _joined(0 * p1, p2 - p3)
        texels = np.arange(-1, n + 1)
        texels = texels % n if side.mode == REPEAT else np.clip(texels, 0, n - 1)
    slope = slope * (0.0 if side.flat else 12 / size)
    weights = [w / size for w in (mean, slope, square, cross)]
    if side.clamped:
        edge = 0 if side.nearest else 1
        first = np.concatenate([[edge], first, [edge + n - 1]])
        weights = [np.pad(w, [(1, 1), (0, 0)]) for w in weights]
        for w in (weights[0], weights[2]):
            w[[0, -1], 0] = 1
    # The last texel once more where weights are 0.
    beyond = max(0, int(first.max()) + weights[0].shape[1] - len(texels))
    return Taps(np.pad(texels, (0, beyond), "edge"), first, *weights)


def _joined(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    return np.pad(left, [(0, 0), (0, 1)]) + np.pad(right, [(0, 0), (1, 0)])


@dataclass(frozen=True)
class Pairs:
    """Blocks from two of the level before, (blocks, 2) each: their place among those stored there, the weights of
    their means in the mean and in the slope, and that of their slopes in the slope.

    ``place`` is where the middle of each lies in the whole, whose size is 1, and ``share`` (blocks) their size there.
    """

    index: np.ndarray
    mean: np.ndarray
    lift: np.ndarray
    slope: np.ndarray
    place: np.ndarray
    share: np.ndarray


def pairs(side: Side) -> Pairs:
    """The blocks of a side, which ``halves``, from those of the level before."""
    count = side.stored
    single = np.full(count, side.ended)
    index = np.repeat(np.arange(count)[:, None], 2, axis=1)
    if not side.ended:
        index = 2 * index + np.array([0, 1]) - int(side.clamped)
    if side.clamped:
        single[[0, -1]] = True
        index[0], index[-1] = 0, (count - 1 if side.ended else 2 * side.count + 1)
    two = ~single[:, None]
    keeps = np.full(count, side.clamped)
    if side.clamped:
        keeps[[0, -1]] = False
    return Pairs(
        index,
        np.where(two, 0.5, [1.0, 0.0]),
        np.where(two, [-1.5, 1.5], 0.0),
        np.where(two, 0.25, keeps[:, None] * [1.0, 0.0]),
        np.where(two, [-0.25, 0.25], 0.0),
        np.where(single, 1.0, 0.5),
    )


__all__ = ["Pairs", "Side", "Taps", "halvings", "pairs", "side", "texel_taps"]
