"""Choosing among many with given probabilities, by inverting a cumulative distribution.

Inversion keeps the stratification of the sample that it consumes, which an alias table does not.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from ..types import types_of


def cumulative(weights: np.ndarray) -> np.ndarray:
    """For weights (..., n) that are not negative: (..., n + 1) float64, from 0 to exactly 1 along the last axis.

    Rows whose weights are all 0 are made uniform.
    """
    weights = np.asarray(weights, dtype=np.float64)
    peak = weights.max(axis=-1, keepdims=True)
    weights = np.where(peak > 0, weights / np.where(peak > 0, peak, 1), 1.0)
    sums = np.zeros((*weights.shape[:-1], weights.shape[-1] + 1))
    np.cumsum(weights, axis=-1, out=sums[..., 1:])
    result: np.ndarray = sums / sums[..., -1:]
    return result


def steps(count: int) -> int:
    """How many halvings :func:`invert` needs among at most ``count`` choices."""
    return max(count - 1, 0).bit_length()


def invert(cdf: Any, offset: Any, count: Any, halvings: int, u: Any, active: Any) -> tuple[Any, Any]:
    """The choice ``i < count`` with ``cdf[offset + i] <= u < cdf[offset + i + 1]``, and where between them ``u`` lies.

    ``cdf`` holds rows of ``count + 1`` numbers from 0 to 1; ``offset`` and ``count`` (UInt) say which row;
    ``halvings`` comes from :func:`steps`. ``u`` (Float) counts as just under 1 from there on. Choices of probability 0
    are never made.
    """
    types = types_of(u)
    just_under_one = 1.0 - 2.0 * types.epsilon
    u = dr.fmin(u, just_under_one)
    low, high = types.UInt(0), types.UInt(count)
    for _ in range(halvings):
        middle = (low + high) >> 1
        right = dr.gather(types.Float, cdf, offset + middle, active) <= u
        low, high = dr.select(right, middle, low), dr.select(right, high, middle)
    first = dr.gather(types.Float, cdf, offset + low, active)
    last = dr.gather(types.Float, cdf, offset + low + 1, active)
    width = last - first
    inside = (u - first) / dr.select(width > 0, width, 1)
    return low, dr.fmax(dr.fmin(inside, just_under_one), 0)
