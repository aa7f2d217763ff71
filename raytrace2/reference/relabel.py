"""Exact p-values by relabelling: which batch came from which renderer must not matter when both sample one
distribution.

A statistic of the true labelling is compared with the same statistic under other labellings of the same batches. Whole
images carry the labels, so the p-value is exact whatever the noise looks like: heavy tails, fireflies, few batches,
pixels that the reconstruction filter correlates (Pitman 1937; early stopping after Besag and Clifford 1991). Statistics
are studentised, which keeps the test nearly exact when the two sides agree in mean but differ in variance (Janssen
1997)."""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import dataclass

import numpy as np

from .student import t_to_z

_ENUMERATE = 20_000
_STOP_AFTER = 20


@dataclass(frozen=True, eq=False)
class Labellings:
    """Rows of ``members`` mark the batches called ours; row 0 is the truth. ``exhaustive``: every labelling is there
    once (swapping the two names is no other labelling when both sides have as many batches)."""

    members: np.ndarray
    ours: int
    exhaustive: bool


@functools.lru_cache(maxsize=4)
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


def relabelling_counts(columns: np.ndarray, margin: np.ndarray, threshold: float, labels: Labellings) -> np.ndarray:
    """For each labelling, how many columns have |z| of Welch's t at or above ``threshold``; element 0 is the truth's
    count.

    ``columns``: (batches, m) values, ours first; ``margin``: (m,) differences too small to count. Stops early, with a
    shorter array, when so many labellings count as much as the truth that the p-value can no longer be small."""
    x = columns - columns.mean(axis=0, dtype=np.float64)
    size = np.abs(x).max(axis=0)
    kept = size > 0.0
    x = (x[:, kept] / size[kept]).astype(np.float32)
    limit = margin[kept] / size[kept]
    squares = x.astype(np.float64) ** 2
    total, total_squares = x.sum(axis=0, dtype=np.float64), squares.sum(axis=0)
    screen = (x / (np.sqrt(total_squares) * _screening_bound(len(x), labels.ours, threshold))).astype(np.float32)
    counts = np.zeros(len(labels.members), dtype=np.int64)
    done, exceeding = 0, 0
    while done < len(counts) and exceeding <= _STOP_AFTER:
        rows = labels.members[done : done + (1 if done == 0 else max(1, min(256, 4_000_000 // max(1, x.shape[1]))))]
        sums = rows @ screen
        row, column = np.nonzero(np.abs(sums, out=sums) >= 1.0)
        z = _abs_z(x, squares, total, total_squares, limit, rows.astype(bool), labels.ours, row, column)
        counts[done : done + len(rows)] = np.bincount(row[z >= threshold], minlength=len(rows))
        done += len(rows)
        exceeding = int((counts[1:done] >= counts[0]).sum())
    return counts[:done]


def relabelling_pvalue(counts: np.ndarray) -> float:
    """Share of labellings, the truth included, that count at least as many columns as the truth."""
    return float((counts >= counts[0]).sum()) / len(counts)


def _screening_bound(n: int, ours: int, threshold: float) -> float:
    """The least |sum of ours| / root of the sum of squares, of a centred column, at which Welch's |z| can reach
    ``threshold``.

    z grows with the degrees of freedom, which are n - 2 at most. Welch's squared standard error is at least the pooled
    one over ``ratio``, reached when all the variance lies on one side; pooled t is a function of the sum alone."""
    reference = n - ours
    df = n - 2.0
    ratio = max(ours - 1, reference - 1) / df * n / min(ours, reference)
    k = (8.0 * df + 1.0) / (8.0 * df + 3.0)
    t2 = df * math.expm1(min((threshold / k) ** 2 / df, 700.0)) / ratio
    return math.sqrt(ours * reference / n * t2 / (df + t2)) * (1.0 - 1e-4)


def _abs_z(
    x: np.ndarray,
    squares: np.ndarray,
    total: np.ndarray,
    total_squares: np.ndarray,
    limit: np.ndarray,
    rows: np.ndarray,
    ours: int,
    row: np.ndarray,
    column: np.ndarray,
) -> np.ndarray:
    """|z| of Welch's t for chosen (labelling, column) pairs, from the sums of one group."""
    reference = x.shape[0] - ours
    result = np.empty(len(row))
    for start in range(0, len(row), 1 << 17):
        part = slice(start, start + (1 << 17))
        c, members = column[part], rows[row[part]].T
        sums = np.where(members, x[:, c], np.float32(0.0)).sum(axis=0, dtype=np.float64)
        sums2 = np.where(members, squares[:, c], 0.0).sum(axis=0)
        rest, rest2 = total[c] - sums, total_squares[c] - sums2
        a = np.maximum((sums2 - sums * sums / ours) / (ours * (ours - 1.0)), 0.0)
        b = np.maximum((rest2 - rest * rest / reference) / (reference * (reference - 1.0)), 0.0)
        result[part] = welch_z(np.abs(sums / ours - rest / reference), a, b, ours, reference, limit[c])
    return result


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
