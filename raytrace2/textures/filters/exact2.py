"""The integral of the reconstructed texture over a footprint of second order: curved, as seen at grazing angles and in
curved mirrors.

The point (s, t) of a pixel (both 0 at its centre) shows uv + s dx + t dy + s^2/2 dxx + s t dxy + t^2/2 dyy. For the box
filter the pixel is cut, across the direction in which the derivatives change the most, into up to four strips of equal
weight, each taken for a parallelogram whose centre is the strip's mean. For smooth filters the map is inverted at
every point of the quadrature, by Newton's method, and its Jacobian weighs the points.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from ...types import types_of
from .exact import LookUp, exact_with_reads, widened
from .exact_cells import Parallelogram
from .exact_ellipse import Region
from .exact_kernel import Kernel, make_kernel
from .exact_walk import integrate

_STRIPS = 4
# The relative change of derivatives across a strip that is let pass.
_CHANGE = 0.02
_NEWTON_STEPS = 3
# Of the Jacobian, relative to the pixel's centre: below this the series has folded over.
_LEAST_DENSITY = 0.1


def exact2(bitmaps: Any, image: Any, uv: Any, footprint: Any, settings: Any, active: Any = True) -> Any:
    """As :func:`~raytrace2.textures.filters.exact.exact`, but over the curved footprint: the same to the last bit where
    second derivatives are unknown (None) or, under the box filter, 0.

    Second derivatives that together exceed the first ones are scaled down to them: there no series tells the shape.
    """
    return exact2_with_reads(bitmaps, image, uv, footprint, settings, active)[0]


def exact2_with_error(
    bitmaps: Any, image: Any, uv: Any, footprint: Any, settings: Any, active: Any = True
) -> tuple[Any, Any]:
    """As :func:`exact2`, and what the curvature changed: an estimate of the error that ``exact`` makes (of the value's
    type, not negative), which bounds that of ``exact2`` where the series converges."""
    curved = exact2(bitmaps, image, uv, footprint, settings, active)
    affine = exact_with_reads(bitmaps, image, uv, footprint, settings, active)[0]
    return curved, dr.abs(curved - affine)


def exact2_with_reads(
    bitmaps: Any, image: Any, uv: Any, footprint: Any, settings: Any, active: Any = True
) -> tuple[Any, Any]:
    """As :func:`exact2`, and how many numbers a channel it read (UInt)."""
    if footprint.dxx is None:
        return exact_with_reads(bitmaps, image, uv, footprint, settings, active)
    kernel = make_kernel(settings.pixel)
    second = _tamed(footprint.dx, footprint.dy, [footprint.dxx, footprint.dxy, footprint.dyy], kernel.radius)
    look_up = LookUp(bitmaps, image, uv, footprint, settings, kernel, active, second)
    region = look_up.footprint
    # Once more, because footprints far beyond a clamped image were cut.
    second = _tamed(region.a, region.b, [v / look_up.scale for v in second], kernel.radius)
    count = None if kernel.sampled else _strips(region, second, look_up.narrow)[1]

    def shape(at: Any, a: Any, b: Any, *second: Any) -> tuple[Any, Any]:
        region = Parallelogram(at, a, b)
        if kernel.sampled:
            invert, support = _inversion(region, list(second), kernel)
            return lambda k: support, kernel.moments(region, invert)
        pieces, _ = _strips(region, list(second), look_up.narrow)
        whole = region.area() / type(uv.x)(count)

        def of_equal_weight(strip: Parallelogram, *cell: Any) -> tuple[Any, ...]:
            share = whole / strip.area()
            return tuple(m * share for m in strip.moments(*cell))

        return pieces, of_equal_weight

    inputs = *look_up.edges, *second
    total, weight, blocks = integrate(bitmaps, look_up.grid, inputs, shape, count, look_up.walks, look_up.most)
    return look_up.value(total, weight), look_up.reads(blocks)


def _tamed(dx: Any, dy: Any, second: list[Any], radius: float) -> list[Any]:
    first = dr.norm(dx) + dr.norm(dy)
    size = dr.norm(second[0]) + dr.norm(second[1]) + dr.norm(second[2])
    most = first * (0.5 / radius)
    scale = dr.select(size > most, most / size, 1)
    return [dr.select(dr.isfinite(size), v * scale, 0) for v in second]


def _strips(region: Parallelogram, second: list[Any], narrow: Any) -> tuple[Any, Any]:
    """Which parallelogram strip k is, and how many strips there are (UInt)."""
    t = types_of(region.a.x)
    at, a, b = region.centre, region.a, region.b
    aa, ab, bb = second
    inverse_a = dr.rcp(dr.fmax(dr.norm(a), 1e-30))
    inverse_b = dr.rcp(dr.fmax(dr.norm(b), 1e-30))
    mixed = dr.norm(ab)
    change_s = dr.norm(aa) * inverse_a + mixed * inverse_b
    change_t = dr.norm(bb) * inverse_b + mixed * inverse_a
    along_t = change_t >= change_s
    strips = dr.ceil(dr.sqrt(dr.fmax(change_s, change_t) * (1 / _CHANGE)))
    strips = dr.fmin(dr.fmax(strips, 1), _STRIPS)
    share = 1 / strips
    share_s, share_t = dr.select(along_t, 1, share), dr.select(along_t, share, 1)

    def piece(k: Any) -> Parallelogram:
        middle = dr.fma(t.Float(k) + 0.5, share, -0.5)
        s, t_ = dr.select(along_t, 0, middle), dr.select(along_t, middle, 0)
        bend_s, bend_t = 0.5 * s * s + share_s * share_s * (1 / 24), 0.5 * t_ * t_ + share_t * share_t * (1 / 24)
        centre = at + (a * s + b * t_ + aa * bend_s + bb * bend_t)
        edges = (a + aa * s + ab * t_) * share_s, (b + ab * s + bb * t_) * share_t
        strip_a, strip_b = widened(*edges, narrow)
        # A single strip is the footprint, to the last bit.
        return Parallelogram(centre, dr.select(strips == 1, a, strip_a), dr.select(strips == 1, b, strip_b))

    return piece, t.UInt(strips)


def _inversion(region: Parallelogram, second: list[Any], kernel: Kernel) -> tuple[Any, Region]:
    """The map back from the grid, relative to the support's centre, to (s, t), with the density of (s, t) there; and
    the support, which the curved footprint fits in."""
    a, b, radius = region.a, region.b, kernel.radius
    area = a.x * b.y - a.y * b.x
    inverse = dr.rcp(area)
    # Second derivatives in terms of a and b themselves.
    in_s = [(v.x * b.y - v.y * b.x) * inverse for v in second]
    in_t = [(a.x * v.y - a.y * v.x) * inverse for v in second]
    r2 = radius * radius
    # s + s^2 k/2 runs over an interval of the same length, moved by k/2, as long as it is monotonic; others widen it.
    shift_s, shift_t = r2 * (0.5 * in_s[0] + 0.25 * in_s[2]), r2 * (0.5 * in_t[2] + 0.25 * in_t[0])
    reach_s = radius + r2 * (dr.abs(in_s[1]) + 0.25 * dr.abs(in_s[2]))
    reach_t = radius + r2 * (dr.abs(in_t[1]) + 0.25 * dr.abs(in_t[0]))
    shift = a * shift_s + b * shift_t
    support = kernel.support(region.centre + shift, a * reach_s, b * reach_t)

    def invert(x: Any, y: Any) -> tuple[Any, Any, Any]:
        x, y = x + shift.x, y + shift.y
        s0, t0 = (x * b.y - y * b.x) * inverse, (a.x * y - a.y * x) * inverse
        s, t = s0, t0
        for step in range(_NEWTON_STEPS):
            s_s, s_t = 1 + s * in_s[0] + t * in_s[1], s * in_s[1] + t * in_s[2]
            t_s, t_t = s * in_t[0] + t * in_t[1], 1 + s * in_t[1] + t * in_t[2]
            determinant = s_s * t_t - s_t * t_s
            scale = dr.rcp(dr.fmax(determinant, _LEAST_DENSITY))
            if step == _NEWTON_STEPS - 1:
                break
            lack_s = s0 - s - (0.5 * s * s * in_s[0] + s * t * in_s[1] + 0.5 * t * t * in_s[2])
            lack_t = t0 - t - (0.5 * s * s * in_t[0] + s * t * in_t[1] + 0.5 * t * t * in_t[2])
            s, t = s + (lack_s * t_t - lack_t * s_t) * scale, t + (lack_t * s_s - lack_s * t_s) * scale
        return s, t, dr.select(determinant > _LEAST_DENSITY, scale, 0)

    return invert, support
