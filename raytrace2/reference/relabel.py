"""Exact p-values by relabelling: which batch came from which renderer must not matter when both sample one distribution.

A statistic of the true labelling is compared with the same statistic under other labellings of the same batches. Whole
images carry the labels, so the p-value is exact whatever the noise looks like: heavy tails, fireflies, few batches, pixels
that the reconstruction filter correlates (Pitman 1937; early stopping after Besag and Clifford 1991). Statistics are
studentised, which keeps the test nearly exact when the two sides agree in mean but differ in variance (Janssen 1997).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .student import t_to_z

_ENUMERATE = 20_000
_STOP_AFTER = 20


@dataclass(frozen=True, eq=False)
class Labellings:
    """Rows of ``members`` mark the batches called ours; row 0 is the truth. ``exhaustive``: every labelling is there once
    (swapping the two names is no other labelling when both sides have as many batches)."""

    members: np.ndarray
    ours: int
    exhaustive: bool


def labellings(ours: int, reference: int, alpha: float, seed: int) -> Labellings:
    """All labellings when there are few, else a random sample of 2 / ``alpha`` of them.

    ``ValueError`` when there are fewer than 1 / alpha: no outcome could then have a p-value of alpha.
    """
    n = ours + reference
    symmetric = ours == reference
    total = distinct(ours, reference)
    if total * alpha < 1.0:
        raise ValueError(
            f"{ours} and {reference} batches are too few to tell a difference at a false-alarm rate this small: "
            "take at least 8 on each side"
        )
    rng = np.random.default_rng(seed)
    truth = np.arange(n) < ours
    if total <= _ENUMERATE:
        rows = np.zeros((math.comb(n, ours), n), dtype=bool)
        for row, chosen in zip(rows, itertools.combinations(range(n), ours), strict=True):
            row[list(chosen)] = True
        if symmetric:
            rows = rows[rows[:, 0]]
        others = rows[(rows != truth).any(axis=1)]
        return Labellings(np.vstack([truth, rng.permutation(others)]).astype(np.float32), ours, True)
    order = rng.random((math.ceil(2.0 / alpha) - 1, n)).argsort(axis=1)
    return Labellings(np.vstack([truth, order < ours]).astype(np.float32), ours, False)


def distinct(ours: int, reference: int) -> int:
    """How many labellings differ."""
    total = math.comb(ours + reference, ours)
    return total // 2 if ours == reference else total


def relabelling_pvalue(
    columns: np.ndarray, margin: np.ndarray, statistic: Callable[[np.ndarray], np.ndarray], labels: Labellings
) -> tuple[float, float, float]:
    """p-value of ``statistic``, its value under the true labels, and its mean under the others.

    ``columns``: (batches, m) values, ours first; ``margin``: (m,) differences too small to count. ``statistic`` maps |z|,
    (labellings, m), to one number each, greater for a greater difference.
    """
    x = (columns - columns.mean(axis=0)).astype(np.float32)
    # One power of two for each column keeps squares away from the ends of float32 without a rounding error.
    scale = np.exp2(np.round(-np.log2(np.maximum(np.abs(x).max(axis=0), 1e-30))))
    x = (x * scale).astype(np.float32)
    limit = (margin * scale).astype(np.float32)
    squares = x * x
    total, total_squares = x.sum(axis=0), squares.sum(axis=0)
    n, count, exceeding, others = len(labels.members), 1, 0, 0.0
    observed = float(statistic(_abs_z(x, squares, total, total_squares, limit, labels.members[:1], labels.ours))[0])
    chunk = max(1, min(256, 2_000_000 // max(1, x.shape[1])))
    while count < n:
        rows = labels.members[count : count + chunk]
        values = statistic(_abs_z(x, squares, total, total_squares, limit, rows, labels.ours))
        # Rounding must not make a labelling that ties with the truth look smaller.
        exceeding += int((values >= observed - 1e-6 * abs(observed)).sum())
        others += float(values.sum())
        count += len(rows)
        if exceeding >= _STOP_AFTER:
            break
    return (1 + exceeding) / count, observed, others / max(1, count - 1)


def _abs_z(
    x: np.ndarray, squares: np.ndarray, total: np.ndarray, total_squares: np.ndarray, limit: np.ndarray,
    rows: np.ndarray, ours: int,
) -> np.ndarray:
    """|z| of Welch's t for each labelling and column, from group sums alone."""
    reference = x.shape[0] - ours
    sums, sums2 = rows @ x, rows @ squares
    rest, rest2 = total - sums, total_squares - sums2
    a = np.maximum((sums2 - sums * sums / ours) / (ours * (ours - 1.0)), 0.0)
    b = np.maximum((rest2 - rest * rest / reference) / (reference * (reference - 1.0)), 0.0)
    return welch_z(np.abs(sums / ours - rest / reference), a, b, ours, reference, limit)


def welch_z(
    difference: np.ndarray, a: np.ndarray, b: np.ndarray, ours: int, reference: int, margin: np.ndarray
) -> np.ndarray:
    """|z| of a |difference| of two means whose squared standard errors are ``a`` and ``b``; capped at 40."""
    t, df = welch_t(difference, a, b, ours, reference, margin)
    return np.minimum(t_to_z(np.minimum(t, 1e9), df), 40.0)


def welch_t(
    difference: np.ndarray, a: np.ndarray, b: np.ndarray, ours: int, reference: int, margin: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Welch's |t| of the part of |difference| beyond ``margin``, and its degrees of freedom (Welch 1947).

    Infinite where the difference counts and neither side varies, 0 where the difference does not count.
    """
    excess = np.maximum(difference - margin, 0.0)
    error = a + b
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(excess > 0.0, excess / np.sqrt(error), 0.0)
        share = np.where(error > 0.0, a / error, 0.5)
    df = 1.0 / (share * share / (ours - 1.0) + (1.0 - share) ** 2 / (reference - 1.0))
    return t, df
