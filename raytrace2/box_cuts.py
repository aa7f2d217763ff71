"""Where boxes cut what a camera sees: lines on surfaces, which show boxes that the camera itself stands in."""

from __future__ import annotations

import numpy as np

from .box_edges import CORNERS, Projection

#: Points this near to a box, relative to the size of the scene, are in it: rounding shall not fray its sides.
_SLACK = 2e-5
#: Neighbouring pixels whose depths differ by more than this share are of different surfaces.
_JUMP = 0.02


def cut_pixels(
    projection: Projection, lo: np.ndarray, hi: np.ndarray, points: np.ndarray, depth: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A bool image of the pixels where ``points`` (H, W, 3), seen at ``depth`` (H, W), go from one set of the boxes
    ``lo``, ``hi`` (n, 3) to another; and which boxes (n,) have any of the points in them."""
    # Sets of boxes are told apart by the sums of their numbers, drawn at random.
    number = np.random.default_rng(0).integers(0, 2**64, len(lo), dtype=np.uint64)
    total = np.zeros(depth.shape, np.uint64)
    held = np.zeros(len(lo), bool)
    valid = np.isfinite(depth)
    if not valid.any():
        return np.zeros(depth.shape, bool), held
    seen = points[valid]
    slack = _SLACK * max(float(np.ptp(seen, axis=0).max()), float((hi - lo).max(initial=0)))
    low, high = lo - slack, hi + slack
    for k, (top, left, bottom, right) in _windows(projection, low, high, depth.shape):
        window = slice(top, bottom), slice(left, right)
        part = points[window]
        inside = valid[window] & (part >= low[k]).all(axis=2) & (part <= high[k]).all(axis=2)
        total[window] += inside * number[k]
        held[k] = inside.any()
    cut = np.zeros(depth.shape, bool)
    with np.errstate(invalid="ignore"):
        for a, b in (
            ((slice(None, -1),), (slice(1, None),)),
            ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
        ):
            near = abs(depth[a] - depth[b]) <= _JUMP * np.minimum(depth[a], depth[b])
            cut[a] |= (total[a] != total[b]) & near
    return cut, held


def _windows(
    projection: Projection, lo: np.ndarray, hi: np.ndarray, shape: tuple[int, ...]
) -> list[tuple[int, tuple[int, int, int, int]]]:
    """Top, left, bottom and right of the pixels in which each box may be seen, for those (by number) that may."""
    corner = projection(np.where(CORNERS, hi[:, None], lo[:, None]))
    here = corner[..., 3] >= projection.near
    with np.errstate(divide="ignore", invalid="ignore"):
        at = corner[..., 1::-1] / corner[..., 2:3] * shape
    least, most = np.floor(at.min(axis=1)), np.ceil(at.max(axis=1))
    # A box that reaches behind the camera may be anywhere.
    partly = ~here.all(axis=1)
    least[partly], most[partly] = 0, shape
    least, most = (np.clip(end, 0, shape).astype(int) for end in (least, most))
    some = np.flatnonzero(here.any(axis=1) & (least < most).all(axis=1))
    return [(int(k), (*least[k].tolist(), *most[k].tolist())) for k in some]
