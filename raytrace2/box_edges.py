"""Edges of boxes as a camera sees them: cut to its view, as pixels, each in front of what is seen there or behind."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from .rays.film_plane import film_axes, perspective_axes
from .scene.description import Camera, PerspectiveCamera

#: An edge that lies on what is seen counts as in front of it: this much farther, relative to the depth, is as near.
_ON_SURFACE = 4e-3
#: Points of edges made at a time.
_POINTS = 1 << 21

#: Of a box: whether each coordinate is the upper one.
CORNERS = np.array(list(itertools.product((False, True), repeat=3)))
_EDGES = np.array([(a, b) for a, b in itertools.combinations(range(8), 2) if (CORNERS[a] != CORNERS[b]).sum() == 1])


@dataclass(frozen=True, eq=False)
class Projection:
    """The map x -> ``matrix`` x + ``offset`` (4 rows) from the world to (u w, v w, w, depth) of the crop window, whose
    film positions (u, v) are in [0, 1]^2 from the top left; ``near``: the least depth seen."""

    matrix: np.ndarray
    offset: np.ndarray
    near: float

    @staticmethod
    def of(camera: Camera) -> Projection:
        """That of a pinhole (a lens is seen through its middle) or an orthographic camera."""
        to_world = np.asarray(camera.to_world, np.float64)
        if isinstance(camera, PerspectiveCamera):
            corner, du, dv = perspective_axes(camera)
            into = np.linalg.inv(np.stack([du, dv, corner], axis=1))
            rows = np.concatenate([into, [[0, 0, 1]]])
            constant = np.zeros(4)
        else:
            corner, du, dv = film_axes(camera.film)
            into = np.linalg.inv(np.stack([du, dv], axis=1))
            rows = np.zeros((4, 3))
            rows[:2, :2], rows[3, 2] = into, 1
            constant = np.array([*(-into @ corner), 1, 0])
        inverse = np.linalg.inv(to_world)
        return Projection(rows @ inverse[:3, :3], rows @ inverse[:3, 3] + constant, camera.near_clip)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) as (..., 4)."""
        return points @ self.matrix.T + self.offset


def edge_pixels(
    projection: Projection, lo: np.ndarray, hi: np.ndarray, depth: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The pixels of the edges of boxes ``lo``, ``hi`` (n, 3) that lie in the view, over an image of ``depth`` (H, W):
    bool images (H, W) of those in front of what is seen there and of those behind, and which boxes (n,) have any."""
    front, behind = (np.zeros(depth.shape, bool) for _ in range(2))
    seen = np.zeros(len(lo), bool)
    for first in range(0, len(lo), 1 << 15):
        part = slice(first, first + (1 << 15))
        corner = projection(np.where(CORNERS, hi[part, None], lo[part, None]))
        begin, end = (corner[:, _EDGES[:, k]].reshape(-1, 4) for k in (0, 1))
        box = first + np.repeat(np.arange(len(corner)), len(_EDGES))
        begin, end, some = in_view(begin, end, projection.near)
        seen[box[some]] = True
        for y, x, far in _points(begin, end, depth.shape):
            near = far <= depth[y, x] * (1 + _ON_SURFACE)
            front[y[near], x[near]] = True
            behind[y[~near], x[~near]] = True
    return front, behind & ~front, seen


def in_view(begin: np.ndarray, end: np.ndarray, near: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Segments (n, 4) as :class:`Projection` gives them, cut at the near plane and at the sides of the view (Liang and
    Barsky 1984, before the division); only those with something left, and their numbers."""
    least, most = np.zeros(len(begin)), np.ones(len(begin))
    for side in (
        lambda p: p[:, 3] - near,
        lambda p: p[:, 0],
        lambda p: p[:, 2] - p[:, 0],
        lambda p: p[:, 1],
        lambda p: p[:, 2] - p[:, 1],
    ):
        a, b = side(begin), side(end)
        with np.errstate(divide="ignore", invalid="ignore"):
            cut = a / (a - b)
        least = np.where((a < 0) & (b >= 0), np.fmax(least, cut), least)
        most = np.where((a >= 0) & (b < 0), np.fmin(most, cut), most)
        most = np.where((a < 0) & (b < 0), -1, most)
    some = np.flatnonzero(least <= most)
    way = (end - begin)[some]
    return begin[some] + least[some, None] * way, begin[some] + most[some, None] * way, some


def _points(
    begin: np.ndarray, end: np.ndarray, shape: tuple[int, ...]
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Row, column and depth of points a pixel apart along segments within the view."""
    height, width = shape
    size = np.array([width, height])
    a, b = (p[:, :2] / p[:, 2:3] * size for p in (begin, end))
    count = np.ceil(np.abs(b - a).max(axis=1)).astype(np.int64) + 1 if len(a) else np.zeros(0, np.int64)
    chunk = np.cumsum(count) // _POINTS
    for some in np.split(np.arange(len(a)), np.flatnonzero(np.diff(chunk)) + 1):
        number = count[some]
        which = np.repeat(some, number)
        along = (np.arange(len(which)) - np.repeat(np.cumsum(number) - number, number)) / np.maximum(
            count[which] - 1, 1
        )
        at = a[which] + along[:, None] * (b - a)[which]
        # Depths over w grow evenly along the image of a segment, as 1 / w does.
        w = (1 - along) / begin[which, 2] + along / end[which, 2]
        far = ((1 - along) * (begin[:, 3] / begin[:, 2])[which] + along * (end[:, 3] / end[:, 2])[which]) / w
        x, y = (np.clip(at[:, k].astype(np.int64), 0, size[k] - 1) for k in (0, 1))
        yield y, x, far
