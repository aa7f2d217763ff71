"""Gears: prisms with long thin triangles on their faces, side by side in a block (after Haines 1987)."""

from __future__ import annotations

import numpy as np

from ...surfaces.mesh import TriangleMesh
from .mesh_parts import Piece, repeated
from .scene import ProceduralScene, View

_TRIANGLES_PER_TOOTH = 32


def gears(size: int, seed: int = 0) -> ProceduralScene:
    """A block of gears with twelve teeth (fewer where ``size`` is small), along three axes by turns, turned at
    random."""
    rng = np.random.default_rng(seed)
    teeth = int(np.clip(size // _TRIANGLES_PER_TOOTH, 3, 12))
    count = max(1, round(size / (_TRIANGLES_PER_TOOTH * teeth)))
    side = int(np.ceil(count ** (1 / 3) - 1e-9))
    index = np.arange(count)
    place = np.stack([index % side, index // side % side, index // side**2], axis=1)
    vertices, faces = _gear(teeth)
    angle = rng.uniform(0, 2 * np.pi, count)[:, None]
    x = np.cos(angle) * vertices[:, 0] - np.sin(angle) * vertices[:, 1]
    y = np.sin(angle) * vertices[:, 0] + np.cos(angle) * vertices[:, 1]
    turned = np.stack([x, y, np.broadcast_to(vertices[:, 2], x.shape)], axis=-1)
    axis = place.sum(axis=1) % 3
    turned = np.take_along_axis(turned, (np.arange(3) + axis[:, None])[:, None] % 3, axis=2)
    centers = (place - (side - 1) / 2) * 1.9
    mesh = TriangleMesh(*repeated(turned + centers[:, None], faces), name="gears")
    reach = 1.9 * side
    view = View(eye=(1.5 * reach, -1.2 * reach, 1.1 * reach), target=(0.0, 0.0, 0.0), x_fov=48.0)
    return ProceduralScene("gears", (mesh,), view)


def _gear(teeth: int) -> Piece:
    """A gear about z of outer radius 1 with a hole, between z = -0.15 and 0.15."""
    n = 4 * teeth
    angle = (np.arange(n) + np.tile([-0.15, 0.15, -0.15, 0.15], teeth)) * 2 * np.pi / n
    outline = np.tile([0.82, 1.0, 1.0, 0.82], teeth)
    loops = []
    # Inner below, outer below, outer above, inner above: each joined with the next, and the last with the first.
    for radius, z in ((0.3, -0.15), (outline, -0.15), (outline, 0.15), (0.3, 0.15)):
        loops.append(np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(n, z)], axis=1))
    index = np.arange(4 * n).reshape(4, n)
    ahead, above = np.roll(index, -1, axis=1), np.roll(index, -1, axis=0)
    a, b, c, d = index.ravel(), ahead.ravel(), np.roll(above, -1, axis=1).ravel(), above.ravel()
    return np.concatenate(loops), np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
