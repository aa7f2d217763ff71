"""Spheres and cylinders by the arrays: what scenes of quadrics are put together from."""

from __future__ import annotations

import numpy as np

from ...surfaces.quadrics import Cylinder, Sphere


def spheres(centers: np.ndarray, radii: np.ndarray | float) -> list[Sphere]:
    """Spheres about ``centers`` (n, 3) of ``radii`` (n,)."""
    return [Sphere.at(c, r) for c, r in zip(centers, np.broadcast_to(radii, len(centers)), strict=True)]


def cylinders(begins: np.ndarray, ends: np.ndarray, radii: np.ndarray | float) -> list[Cylinder]:
    """Open cylinders of ``radii`` (n,) from ``begins`` (n, 3) to ``ends`` (n, 3)."""
    matrices = np.zeros((len(begins), 4, 4))
    along = ends - begins
    x, y = perpendicular(along)
    radii = np.broadcast_to(radii, len(begins))[:, None]
    matrices[:, :3, 0], matrices[:, :3, 1], matrices[:, :3, 2] = x * radii, y * radii, along
    matrices[:, :3, 3] = begins
    matrices[:, 3, 3] = 1
    return [Cylinder(m) for m in matrices]


def perpendicular(axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors (n, 3) each at right angles to ``axes`` (n, 3) and to each other; right-handed with them."""
    steep = np.abs(axes[:, 2:]) > 0.9 * np.linalg.norm(axes, axis=1, keepdims=True)
    helper = np.where(steep, (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    x = np.cross(helper, axes)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    y = np.cross(axes, x)
    return x, y / np.linalg.norm(y, axis=1, keepdims=True)
