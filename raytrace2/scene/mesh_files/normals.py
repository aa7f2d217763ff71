"""Vertex normals: those of the file made unit, those that it lacks computed."""

from __future__ import annotations

import numpy as np


def finish_normals(
    vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray | None, *, face_normals: bool = False
) -> np.ndarray | None:
    """Shading normals (n, 3) float64 of unit length, or None where ``face_normals`` asks for flat shading.

    ``vertices`` (n, 3) and ``normals`` (n, 3) or None are in world coordinates: computed normals are angle-weighted, so
    they must come after ``to_world``. Rows of zeros in ``normals`` mark vertices without one; they get a computed one.
    """
    if face_normals:
        return None
    if normals is None:
        return vertex_normals(vertices, faces)
    missing = ~np.any(normals, axis=1)
    unit = _unit(np.asarray(normals, dtype=np.float64))
    if missing.any():
        unit[missing] = vertex_normals(vertices, faces)[missing]
    return unit


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals (n, 3) float64: the mean of the normals of the faces around each vertex, weighted by face angle.

    Faces without area count for nothing; a vertex that only they use, or none, gets (1, 0, 0), as in Mitsuba.
    Source: Thuermer and Wuethrich, "Computing Vertex Normals from Polygonal Facets", JGT 3(1), 1998.
    """
    corners = np.asarray(vertices, dtype=np.float64)[faces]
    # Differences and products under- or overflow at scales that coordinates can have: each face is brought to
    # coordinates below 1, exactly, and its edges to unit length before they are multiplied.
    _, exponent = np.frexp(np.abs(corners).max(axis=(1, 2), keepdims=True, initial=0.0))
    corners = np.ldexp(corners, -exponent)
    edges = _unit(np.roll(corners, -1, axis=1) - corners)
    totals = np.zeros((len(vertices), 3))
    for i in range(3):
        ahead, back = edges[:, i], -edges[:, i - 1]
        cross = np.cross(ahead, back)
        # atan2 keeps the angle accurate where the arc cosine loses half the digits, near 0 and pi.
        angle = np.arctan2(np.linalg.norm(cross, axis=1), np.einsum("ij,ij->i", ahead, back))
        weighted = _unit(cross) * angle[:, None]
        for axis in range(3):
            totals[:, axis] += np.bincount(faces[:, i], weighted[:, axis], minlength=len(vertices))
    result = _unit(totals)
    result[~np.any(totals, axis=1)] = (1.0, 0.0, 0.0)
    return result


def _unit(v: np.ndarray) -> np.ndarray:
    """``v`` (..., 3) over its length, zero where it is zero; scaled exactly first, so that squares stay in range."""
    largest = np.abs(v).max(axis=-1, keepdims=True)
    _, exponent = np.frexp(largest)
    scaled = np.ldexp(v, -exponent)
    length = np.sqrt(np.einsum("...i,...i->...", scaled, scaled))[..., None]
    return scaled / np.where(length > 0, length, 1.0)
