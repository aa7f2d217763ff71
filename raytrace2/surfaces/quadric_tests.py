"""Ray tests of spheres, rectangles, disks and cylinders on primitive records.

Each takes a record's words and a ray and gives, for the *line* of the ray: whether it is met between ``tmin`` and
``tmax``, t there, and two surface coordinates (zero for the sphere and the cylinder, whose parameterisation is
recovered from the point; local x and y for rectangles and disks).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import drjit as dr

from .compensated import dot, point_on_ray, squares_minus_square, two_sum


def intersect_sphere(words: list[Any], ray: Any, tmin: Any, tmax: Any) -> tuple[Any, Any, Any, Any]:
    """Words: centre, radius.

    The discriminant is formed where the line is nearest to the centre, which does not cancel for small or distant
    spheres (Haines et al., Ray Tracing Gems, chapter 7, 2019); what subtractions leave of the squares of a radius and
    of a distance that is all but it, in twice the digits: beside a huge sphere too t has all of its own.
    """
    radius, d = words[3], ray.d
    inverse = dr.rcp(dr.squared_norm(d))
    o, o_lost = _moved(ray.o, words[:3])
    nearest = -dr.fma(o[0], d.x, dr.fma(o[1], d.y, o[2] * d.z)) * inverse
    across, across_lost = point_on_ray(o, o_lost, d, nearest)
    # From afar, rounding leaves a part along the ray, as large as the sphere.
    along, along_lost = dot(d, across, across_lost)
    rest = -(along + along_lost) * inverse
    square = dr.fma(-rest, along, -squares_minus_square(across, across_lost, radius)) * inverse
    near, far = _roots(nearest + rest, square, squares_minus_square(o, o_lost, radius) * inverse)
    t = dr.select(near >= tmin, near, far)
    zero = dr.zeros(type(t), dr.width(t))
    return (square >= 0) & (radius > 0) & (t >= tmin) & (t <= tmax), t, zero, zero


def intersect_rectangle(words: list[Any], ray: Any, tmin: Any, tmax: Any) -> tuple[Any, Any, Any, Any]:
    """Words: the rows of the linear part of the world-to-local map, each with a component of the centre; the rectangle
    is [-1, 1]^2 in the local plane z = 0."""
    t, x, y = _meet_plane(words, ray)
    return (abs(x) <= 1) & (abs(y) <= 1) & (t >= tmin) & (t <= tmax), t, x, y


def intersect_disk(words: list[Any], ray: Any, tmin: Any, tmax: Any) -> tuple[Any, Any, Any, Any]:
    """Words: as for the rectangle; the disk has unit radius in the local plane z = 0."""
    t, x, y = _meet_plane(words, ray)
    return (dr.fma(x, x, y * y) <= 1) & (t >= tmin) & (t <= tmax), t, x, y


def intersect_cylinder(words: list[Any], ray: Any, tmin: Any, tmax: Any) -> tuple[Any, Any, Any, Any]:
    """Words: as for the rectangle; the open cylinder has unit radius about local z from 0 to 1. The arithmetic is that
    of the sphere, across the axis."""
    one = type(ray.o.x)(1)
    rows = [_row(words, k) for k in range(3)]
    dx, dy, dz = (dr.fma(r[0], ray.d.x, dr.fma(r[1], ray.d.y, r[2] * ray.d.z)) for r in rows)
    o, o_lost = _moved(ray.o, _center(words))
    start, start_lost = _pairs(dot(r, o, o_lost) for r in rows[:2])
    a = dr.fma(dx, dx, dy * dy)
    inverse = dr.rcp(a)
    nearest = -dr.fma(start[0], dx, start[1] * dy) * inverse
    at, at_lost = point_on_ray(o, o_lost, ray.d, nearest)
    across, across_lost = _pairs(dot(r, at, at_lost) for r in rows)
    along = dr.fma(across[0], dx, across[1] * dy)
    rest = -along * inverse
    square = dr.fma(-rest, along, -squares_minus_square(across[:2], across_lost[:2], one)) * inverse
    near, far = _roots(nearest + rest, square, squares_minus_square(start, start_lost, one) * inverse)
    # From where the line is nearest to the axis: roots have no digits from afar.
    half_chord = dr.sqrt(square)
    near_z, far_z = dr.fma(rest - half_chord, dz, across[2]), dr.fma(rest + half_chord, dz, across[2])
    use_near = (near >= tmin) & (near <= tmax) & (near_z >= 0) & (near_z <= 1)
    use_far = (far >= tmin) & (far <= tmax) & (far_z >= 0) & (far_z <= 1)
    t = dr.select(use_near, near, far)
    zero = dr.zeros(type(t), dr.width(t))
    return (square >= 0) & (a > 0) & (use_near | use_far), t, zero, zero


def _roots(middle: Any, square: Any, product: Any) -> tuple[Any, Any]:
    """The roots, in order, that lie the square root of ``square`` to either side of ``middle``, and whose product is
    ``product``. The larger one in size is free of cancellation; the other follows from the product."""
    q = middle + dr.copysign(dr.sqrt(square), middle)
    other = dr.select(q != 0, product / q, 0)
    return dr.fmin(q, other), dr.fmax(q, other)


def _row(words: list[Any], k: int) -> list[Any]:
    return words[4 * k : 4 * k + 3]


def _center(words: list[Any]) -> list[Any]:
    return [words[3], words[7], words[11]]


def _moved(o: Any, center: list[Any]) -> tuple[list[Any], list[Any]]:
    """The components of ``o - center``, and what their rounding loses."""
    return _pairs(two_sum(o[k], -center[k]) for k in range(3))


def _pairs(pairs: Iterable[tuple[Any, Any]]) -> tuple[list[Any], list[Any]]:
    values, lost = zip(*pairs, strict=True)
    return list(values), list(lost)


def _meet_plane(words: list[Any], ray: Any) -> tuple[Any, Any, Any]:
    """t where the line meets the local plane z = 0, and local x and y there."""
    rows = [_row(words, k) for k in range(3)]
    o, o_lost = _moved(ray.o, _center(words))
    slope, slope_lost = dot(rows[2], ray.d, [0, 0, 0])
    inverse = dr.rcp(slope + slope_lost)
    height, height_lost = dot(rows[2], o, o_lost)
    t = -(height + height_lost) * inverse
    p, p_lost = point_on_ray(o, o_lost, ray.d, t)
    # From afar, rounding leaves the point off the plane: move on along the ray.
    height, height_lost = dot(rows[2], p, p_lost)
    rest = -(height + height_lost) * inverse
    p = [dr.fma(rest, ray.d[k], p[k]) for k in range(3)]
    x, y = (dr.fma(r[0], p[0], dr.fma(r[1], p[1], r[2] * p[2])) for r in rows[:2])
    return t + rest, x, y
