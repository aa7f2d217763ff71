"""Martin Newell's teapot (1975): 32 bicubic Bezier patches, and how to make triangles of them."""

from __future__ import annotations

import numpy as np

from ...surfaces.mesh import TriangleMesh
from .mesh_parts import Piece, boxes, floor, grid_faces, joined, repeated, without_collapsed
from .scene import ProceduralScene, View

# Rim, body (two), knob, lid and bottom are turned about z: radius and height of four control points each.
_TURNED = (
    ((1.4, 2.4), (1.3375, 2.53125), (1.4375, 2.53125), (1.5, 2.4)),
    ((1.5, 2.4), (1.75, 1.875), (2.0, 1.35), (2.0, 0.9)),
    ((2.0, 0.9), (2.0, 0.45), (1.5, 0.225), (1.5, 0.15)),
    ((0.0, 3.15), (0.8, 3.15), (0.0, 2.85), (0.2, 2.7)),
    ((0.2, 2.7), (0.4, 2.55), (1.3, 2.55), (1.3, 2.4)),
    ((0.0, 0.0), (1.425, 0.0), (1.5, 0.075), (1.5, 0.15)),
)

# Handle (two) and spout (two) are mirrored in y = 0: four rows of x, z on one side, x, z on the other, and half width.
_MIRRORED = (
    ((-1.6, 2.025, -1.5, 2.25, 0.3), (-2.3, 2.025, -2.5, 2.25, 0.3))
    + ((-2.7, 2.025, -3.0, 2.25, 0.3), (-2.7, 1.8, -3.0, 1.8, 0.3)),
    ((-2.7, 1.8, -3.0, 1.8, 0.3), (-2.7, 1.575, -3.0, 1.35, 0.3))
    + ((-2.5, 1.125, -2.65, 0.9375, 0.3), (-2.0, 0.9, -1.9, 0.6, 0.3)),
    ((1.7, 1.425, 1.7, 0.6, 0.66), (2.6, 1.425, 3.1, 0.825, 0.66))
    + ((2.3, 2.1, 2.4, 2.025, 0.25), (2.7, 2.4, 3.3, 2.4, 0.25)),
    ((2.7, 2.4, 3.3, 2.4, 0.25), (2.8, 2.475, 3.525, 2.49375, 0.25))
    + ((2.9, 2.475, 3.45, 2.5125, 0.15), (2.8, 2.4, 3.2, 2.4, 0.15)),
)


def teapot_patches() -> np.ndarray:
    """Control points (32, 4, 4, 3), z up, in the coordinates of the original: about 6.5 wide and 3.15 high."""
    found: list[list[list[tuple[float, float, float]]]] = []
    for profile in _TURNED:
        for quarter in range(4):
            c, s = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[quarter]
            rows: list[list[tuple[float, float, float]]] = []
            for r, z in profile:
                # The original rounds the control points of its quarter circles; of the knob's, to two digits.
                k = 0.45 if r == 0.8 else 0.56 * r
                rows.append([(c * x - s * y, s * x + c * y, z) for x, y in ((r, 0.0), (r, k), (k, r), (0.0, r))])
            found.append(rows)
    for strip in _MIRRORED:
        for side in (-1.0, 1.0):
            found.append([[(a, 0.0, b), (a, side * w, b), (c, side * w, d), (c, 0.0, d)] for a, b, c, d, w in strip])
    return np.array(found, dtype=np.float64)


def teapot_mesh(segments: int) -> Piece:
    """Every patch as ``segments`` x ``segments`` squares of two triangles; those that collapse at poles are left
    out."""
    t = np.linspace(0, 1, segments + 1)
    weights = np.stack([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3], axis=1)
    points = np.einsum("ui,vj,pijk->puvk", weights, weights, teapot_patches())
    # On a grid that float32 holds, so that the points that patches share are the same in both.
    points = np.round(points * 2.0**18) / 2.0**18
    return without_collapsed(*repeated(points.reshape(len(points), -1, 3), grid_faces(segments, segments)))


def teapot(size: int, seed: int = 0) -> ProceduralScene:
    """The teapot on a table of two triangles. ``seed`` has no effect."""
    segments = max(1, round(((size - 2) / 64) ** 0.5))
    pot, table = TriangleMesh(*teapot_mesh(segments), name="teapot"), TriangleMesh(*floor(8.0), name="table")
    view = View(eye=(3.6, -7.6, 4.6), target=(0.2, 0.0, 1.3), x_fov=42.0)
    return ProceduralScene("teapot", (pot, table), view)


def stadium(size: int, seed: int = 0) -> ProceduralScene:
    """A teapot in a stadium: two fifths of the triangles in a pot two hundred times smaller than the stands around
    it."""
    pot = teapot_mesh(max(1, round((0.4 * size / 64) ** 0.5)))
    seats = max(1, (size - len(pot[1]) - 2) // 12)
    rows = max(1, round((seats / 24) ** 0.5))
    around = -(-seats // rows)
    row, angle = np.arange(seats) % rows, (np.arange(seats) // rows + 0.5) * 2 * np.pi / around
    # Steps of an oval: solid down to the ground, of triangles that are as wide as a seat and as tall as the stand.
    step, tread = 200 / rows, 300 / rows
    long, short = 550 + tread * row, 380 + tread * row
    x, y, top = long * np.cos(angle), short * np.sin(angle), step * (row + 1)
    width = 0.85 * 2 * np.pi / around * np.hypot(long * np.sin(angle), short * np.cos(angle))
    facing = np.arctan2(y * long, x * short)
    stands = boxes(np.column_stack([x, y, top / 2]), np.column_stack([np.full(seats, tread), width, top]), facing)
    mesh = TriangleMesh(*joined([floor(900.0), stands]), name="stadium")
    view = View(eye=(5.0, -10.0, 3.4), target=(0.0, 0.0, 2.6), x_fov=55.0)
    return ProceduralScene("stadium", (TriangleMesh(*pot, name="teapot"), mesh), view)
