"""A building: slabs and walls of two triangles a side, and furniture, railings and trinkets down to millimetres."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ...surfaces.mesh import TriangleMesh
from .mesh_parts import Piece, boxes, joined
from .scene import ProceduralScene, View

_BAY, _HEIGHT = 6.0, 3.5  # metres between columns, and from floor to floor
_SEATS = np.array([(-0.6, -0.65), (0.6, -0.65), (-0.6, 0.65), (0.6, 0.65)])

# A table with four chairs: centres and sizes of boxes, relative to the floor below the table's middle.
_TABLE = [
    ((0, 0, 0.73), (1.8, 0.9, 0.04)),
    *(((x, y, 0.355), (0.06, 0.06, 0.71)) for x in (-0.8, 0.8) for y in (-0.4, 0.4)),
]
_CHAIR = [
    ((0, 0, 0.45), (0.42, 0.42, 0.03)),
    ((0, 0.2, 0.72), (0.42, 0.02, 0.5)),
    *(((x, y, 0.22), (0.03, 0.03, 0.44)) for x in (-0.19, 0.19) for y in (-0.19, 0.19)),
]


def architecture(size: int, seed: int = 0) -> ProceduralScene:
    """Storeys of bays of six metres, each with a column, a table and chairs; a sixth of the triangles are railings,
    and what is left lies on the tables, from a millimetre to a hand wide."""
    rng = np.random.default_rng(seed)
    bays = max(1, round(size / 1500))
    wide = max(1, round(bays ** (1 / 3) * 1.3))
    deep = max(1, round((bays / wide) ** 0.5))
    storeys = max(1, round(bays / (wide * deep)))
    origin = np.stack(np.meshgrid(np.arange(wide), np.arange(deep), np.arange(storeys), indexing="ij"), axis=-1)
    origin = origin.reshape(-1, 3) * (_BAY, _BAY, _HEIGHT)
    pieces = [_shell(wide, deep, storeys)]
    left = size // 12 - len(pieces[0][1]) // 12
    for make in (_columns, _furniture):
        piece = make(origin, rng)
        if len(piece[1]) // 12 <= left:
            pieces.append(piece)
            left -= len(piece[1]) // 12
    rails = min(left, size // 72)
    if rails:
        pieces.append(_railing(rails, wide, deep, storeys))
        left -= rails
    if left > 0:
        pieces.append(_trinkets(left, origin, rng))
    mesh = TriangleMesh(*joined(pieces), name="architecture")
    view = View(eye=(0.5, 0.6, 1.75), target=(3.6, 3.4, 0.85), x_fov=70.0)
    return ProceduralScene("architecture", (mesh,), view)


def _shell(wide: int, deep: int, storeys: int) -> Piece:
    """Slabs, and walls on two sides: whole storeys in one piece, hundreds of square metres to a triangle."""
    x, y = wide * _BAY, deep * _BAY
    level = np.arange(storeys + 1)[:, None]
    slabs = boxes(level * (0, 0, _HEIGHT) + (x / 2, y / 2, -0.1), (x, y, 0.2))
    tall = storeys * _HEIGHT
    walls = boxes(np.array([(x / 2, y, tall / 2), (x, y / 2, tall / 2)]), np.array([(x, 0.2, tall), (0.2, y, tall)]))
    return joined([slabs, walls])


def _columns(origin: np.ndarray, rng: np.random.Generator) -> Piece:
    return boxes(origin + (_BAY - 0.5, _BAY - 0.5, _HEIGHT / 2), (0.35, 0.35, _HEIGHT))


def _furniture(origin: np.ndarray, rng: np.random.Generator) -> Piece:
    """A table and four chairs in every bay, each set turned by some angle and each chair by another."""
    turn = rng.uniform(-0.4, 0.4, len(origin))
    middle = origin + (_BAY / 2, _BAY / 2, 0)
    parts = [_placed(_TABLE, middle, turn)]
    for seat in _SEATS:
        own = turn + rng.uniform(-0.3, 0.3, len(origin)) + (np.pi if seat[1] < 0 else 0)
        parts.append(_placed(_CHAIR, middle + _turned(np.append(seat, 0.0), turn), own))
    return joined(parts)


def _placed(parts: Sequence[tuple[ArrayLike, ArrayLike]], at: np.ndarray, turn: np.ndarray) -> Piece:
    return joined([boxes(at + _turned(np.asarray(center), turn), size, turn) for center, size in parts])


def _turned(offset: np.ndarray, angle: np.ndarray) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = offset
    return np.stack([c * x - s * y, s * x + c * y, np.full(len(angle), z)], axis=1)


def _railing(count: int, wide: int, deep: int, storeys: int) -> Piece:
    """``count`` balusters along the open front of the storeys, a metre high and as thick as a finger."""
    storey = np.arange(count) % storeys
    along = (np.arange(count) // storeys + 0.5) * wide * _BAY / -(-count // storeys)
    centers = np.stack([along, np.full(count, 0.05), storey * _HEIGHT + 0.5], axis=1)
    return boxes(centers, (0.012, 0.012, 1.0))


def _trinkets(count: int, origin: np.ndarray, rng: np.random.Generator) -> Piece:
    """``count`` boxes on the tables, most of them tiny."""
    table = origin[rng.integers(0, len(origin), count)] + (_BAY / 2, _BAY / 2, 0.75)
    size = np.exp(rng.uniform(np.log(0.001), np.log(0.12), (count, 1))) * rng.uniform(0.4, 1, (count, 3))
    place = rng.uniform(-1, 1, (count, 2)) * (0.7, 0.3)
    centers = table + np.column_stack([place, size[:, 2] / 2])
    return boxes(centers, size, rng.uniform(0, np.pi, count))
