"""Whether a ray really meets triangles: floating point where its error bound leaves no doubt, else rational numbers."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

#: Roundings in an orientation computed below, times the unit round-off, with room to spare.
_BOUND = 32 * 2.0**-53

Rational = list[Fraction]


def really_meets(vertices: np.ndarray, faces: np.ndarray, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """(n,) bool: whether the half-line from ``o`` (n, 3) along ``d`` (n, 3) meets any of the faces (n, k, 3), edges and
    corners included. Coordinates are taken as they are, as the rational numbers that floats stand for."""
    met = np.zeros(len(o), bool)
    o, d = o.astype(np.float64), d.astype(np.float64)
    for k in range(faces.shape[1]):
        rest = np.flatnonzero(~met)
        if len(rest) == 0:
            break
        corners = vertices[faces[rest, k]]
        sure, doubt = _filtered(corners, o[rest], d[rest])
        for i in np.flatnonzero(doubt):
            sure[i] = exactly_meets(corners[i], o[rest[i]], d[rest[i]])
        met[rest[sure]] = True
    return met


def meets_mesh(vertices: np.ndarray, faces: np.ndarray, o: np.ndarray, d: np.ndarray) -> bool:
    """The same for one ray and every face (m, 3) of a mesh."""
    count = len(faces)
    many = np.broadcast_to(o, (count, 3)).astype(np.float64), np.broadcast_to(d, (count, 3)).astype(np.float64)
    corners = vertices[faces]
    sure, doubt = _filtered(corners, *many)
    return bool(sure.any()) or any(exactly_meets(corners[i], o, d) for i in np.flatnonzero(doubt))


def exactly_meets(corners: np.ndarray, o: np.ndarray, d: np.ndarray) -> bool:
    """One ray and one triangle (3, 3), in rational numbers. A triangle seen edge-on is not met: its neighbours are."""
    at = [_rational(c) for c in (*corners, o, d)]
    a, b, c = ([p - q for p, q in zip(corner, at[3], strict=True)] for corner in at[:3])
    w, u, v = _triple(at[4], a, b), _triple(at[4], b, c), _triple(at[4], c, a)
    determinant = u + v + w
    if determinant == 0:
        return False
    sign = 1 if determinant > 0 else -1
    return min(u * sign, v * sign, w * sign) >= 0 and _triple(a, b, c) * sign >= 0


def _filtered(corners: np.ndarray, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rays (n, 3) and triangles (n, 3, 3) that certainly meet, and those of which float64 cannot tell."""
    arms = corners - o[:, None]
    a, b, c = arms.transpose(1, 0, 2)
    # What subtraction rounds off is no larger than a share of the coordinates; often it is exact, and then nothing.
    exact = (_rounded_off(corners, o[:, None], arms) == 0).all(axis=(1, 2))
    size = np.abs(arms).max(axis=(1, 2))
    size = np.where(exact, size, np.abs(corners).max(axis=(1, 2)) + np.abs(o).max(axis=1))
    signs = []
    for p, q, r in ((d, a, b), (d, b, c), (d, c, a), (a, b, c)):
        value = (p * np.cross(q, r)).sum(axis=1)
        terms = 6 * np.abs(p).max(axis=1) * size**2 if p is d else 6 * size**3
        signs.append(np.where(value > _BOUND * terms, 1, np.where(value < -_BOUND * terms, -1, 0)))
    table = np.stack(signs)
    sure = np.abs(table.sum(axis=0)) == 4
    apart = (table.max(axis=0) == 1) & (table.min(axis=0) == -1)
    return sure, ~sure & ~apart


def _rounded_off(x: np.ndarray, y: np.ndarray, difference: np.ndarray) -> np.ndarray:
    """What the ``difference`` x - y lacks (Knuth 1969)."""
    part = difference - x
    return (x - (difference - part)) - (y + part)


def _rational(v: np.ndarray) -> Rational:
    return [Fraction(float(x)) for x in v]


def _triple(p: Rational, q: Rational, r: Rational) -> Fraction:
    x = q[1] * r[2] - q[2] * r[1]
    y = q[2] * r[0] - q[0] * r[2]
    return p[0] * x + p[1] * y + p[2] * (q[0] * r[1] - q[1] * r[0])
