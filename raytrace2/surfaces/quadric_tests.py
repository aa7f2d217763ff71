"""Ray tests of spheres, rectangles, disks and cylinders on primitive records.

Each takes a record's words and a ray and gives, for the *line* of the ray: whether it is met between ``tmin`` and
``tmax``, t there, and two surface coordinates (zero for the sphere and the cylinder, whose parameterisation is
recovered from the point; local x and y for rectangles and disks).
"""

from __future__ import annotations

from typing import Any

import drjit as dr


def intersect_sphere(words: list[Any], ray: Any, tmin: Any, tmax: Any) -> tuple[Any, Any, Any, Any]:
    """Words: centre, radius. The discriminant is formed from the line's distance to the centre, which does not cancel
    for small or distant spheres (Haines et al., Ray Tracing Gems, chapter 7, 2019)."""
    Vector = type(ray.o)
    center, radius = Vector(words[0], words[1], words[2]), words[3]
    f = center - ray.o
    a = dr.squared_norm(ray.d)
    inverse = dr.rcp(a)
    b = dr.dot(f, ray.d)
    nearest = b * inverse
    # What the subtraction above rounded off (Knuth's two-sum): from afar that is as large as the sphere.
    back = f - center
    lost = (center - (f - back)) - (ray.o + back)
    across = dr.fma(-nearest, ray.d, f) + lost
    # From afar, rounding leaves a part along the ray, as large as the sphere: take it out once more.
    rest = dr.dot(across, ray.d) * inverse
    across = dr.fma(-rest, ray.d, across)
    nearest += rest
    discriminant = dr.fma(radius, radius, -dr.squared_norm(across))
    half_chord = dr.sqrt(discriminant * inverse)
    # The larger root in size is free of cancellation; the other follows from their product.
    q = nearest + dr.copysign(half_chord, nearest)
    product = dr.fma(-radius, radius, dr.squared_norm(f)) * inverse
    other = dr.select(q != 0, product / q, 0)
    near, far = dr.fmin(q, other), dr.fmax(q, other)
    t = dr.select(near >= tmin, near, far)
    zero = dr.zeros(type(t), dr.width(t))
    return (discriminant >= 0) & (radius > 0) & (t >= tmin) & (t <= tmax), t, zero, zero


def intersect_rectangle(words: list[Any], ray: Any, tmin: Any, tmax: Any) -> tuple[Any, Any, Any, Any]:
    """Words: the rows of the world-to-local matrix; the rectangle is [-1, 1]^2 in the local plane z = 0."""
    t, x, y = _meet_plane(words, ray)
    return (abs(x) <= 1) & (abs(y) <= 1) & (t >= tmin) & (t <= tmax), t, x, y


def intersect_disk(words: list[Any], ray: Any, tmin: Any, tmax: Any) -> tuple[Any, Any, Any, Any]:
    """Words: the rows of the world-to-local matrix; the disk has unit radius in the local plane z = 0."""
    t, x, y = _meet_plane(words, ray)
    return (dr.fma(x, x, y * y) <= 1) & (t >= tmin) & (t <= tmax), t, x, y


def intersect_cylinder(words: list[Any], ray: Any, tmin: Any, tmax: Any) -> tuple[Any, Any, Any, Any]:
    """Words: the rows of the world-to-local matrix; the open cylinder has unit radius about local z from 0 to 1."""
    dx, dy, dz = (_row(words, k, ray.d, 0) for k in range(3))
    # The origin moves along the ray to near the cylinder, so that none of the digits that matter are lost from afar.
    far_x, far_y, far_z = (_row(words, k, ray.o, 1) for k in range(3))
    a = dr.fma(dx, dx, dy * dy)
    shift = -dr.fma(far_x, dx, dr.fma(far_y, dy, far_z * dz)) / dr.fma(dz, dz, a)
    o = dr.fma(ray.d, shift, ray.o)
    ox, oy, oz = (_row(words, k, o, 1) for k in range(3))
    inverse = dr.rcp(a)
    nearest = -dr.fma(ox, dx, oy * dy) * inverse
    ax, ay = dr.fma(nearest, dx, ox), dr.fma(nearest, dy, oy)
    discriminant = 1 - dr.fma(ax, ax, ay * ay)
    half_chord = dr.sqrt(discriminant * inverse)
    # As for the sphere: one root without cancellation, the other from their product.
    q = nearest + dr.copysign(half_chord, nearest)
    other = dr.select(q != 0, (dr.fma(ox, ox, oy * oy) - 1) * inverse / q, 0)
    near, far = dr.fmin(q, other), dr.fmax(q, other)
    near_z, far_z = dr.fma(near, dz, oz), dr.fma(far, dz, oz)
    near, far = near + shift, far + shift
    use_near = (near >= tmin) & (near <= tmax) & (near_z >= 0) & (near_z <= 1)
    use_far = (far >= tmin) & (far <= tmax) & (far_z >= 0) & (far_z <= 1)
    t = dr.select(use_near, near, far)
    zero = dr.zeros(type(t), dr.width(t))
    return (discriminant >= 0) & (a > 0) & (use_near | use_far), t, zero, zero


def _row(words: list[Any], k: int, v: Any, w: int) -> Any:
    x, y, z, translation = words[4 * k : 4 * k + 4]
    rest = dr.fma(z, v.z, translation) if w else z * v.z
    return dr.fma(x, v.x, dr.fma(y, v.y, rest))


def _meet_plane(words: list[Any], ray: Any) -> tuple[Any, Any, Any]:
    """t where the line meets the local plane z = 0, and local x and y there."""
    slope = dr.rcp(_row(words, 2, ray.d, 0))
    t = -_row(words, 2, ray.o, 1) * slope
    p = dr.fma(ray.d, t, ray.o)
    # From afar, rounding leaves the point off the plane: move on along the ray.
    rest = -_row(words, 2, p, 1) * slope
    p = dr.fma(ray.d, rest, p)
    return t + rest, _row(words, 0, p, 1), _row(words, 1, p, 1)
