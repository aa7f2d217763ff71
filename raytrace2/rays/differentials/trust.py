"""Where first derivatives do not tell how far a pixel reaches, and what is put in their place.

Flags, each with a rule on quantities of first order, and what is done so that filters need not know:

``SILHOUETTE``
    The cosine between the ray and the shading normal would change over a pixel by more than itself: the edge of a ball
    or the horizon of a plane lies within it. The true difference grows as a square root there, where the derivative
    goes to infinity: both derivatives of that direction are shrunk by sqrt(cosine / change), which is the size of the
    true difference over the pixel. The flag stays with the ray.
``TOTAL_REFLECTION``
    The same of the cosine of a refracted ray; that of its direction is shrunk.
``FOLDED``
    The cross-section of the beam is less than a sixteenth of the terms that cancel in it (det(o + t d) is a polynomial
    in t, and caustics are where it vanishes): neighbouring rays cross here. Both vectors of the footprint are kept at
    no less than a sixteenth of *their* terms, the root of o^2 + (t d)^2. The ray goes on as it was.
``WIDENED``
    The ray, or one before it, was chosen at random with a density: its footprint is a guess at the part of the lobe
    that it stands for (:mod:`.widening`), of which filters heed the size alone. The flag stays with the ray.
``SEAM``
    A pole, or the line where an angle starts again, lies within the footprint. No angle changes by more than a turn.

What is not finite is zero, and nothing is longer than :data:`LONGEST`. A second order is zero where a flag is set.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ...surfaces import record
from ..footprint import WIDENED, Footprint
from ..ray import Ray
from .bending import kind_code
from .lobes import Lobe
from .state import RayDifferential
from .widening import widened

FOLDED, TOTAL_REFLECTION, SILHOUETTE, SEAM = 1, 2, 4, 8

#: The part of cancelling terms below which a beam counts as folded, and which footprints keep.
CANCELLED = 1 / 16
#: The longest footprint, in units of uv.
LONGEST = 2.0**20


@dataclass
class Trust:
    """What was found of a ray at a surface: the ``flags`` (UInt) to carry on, and by what to shrink (Floats) what
    changes to the right and down."""

    flags: Any
    x: Any
    y: Any


def trusted_footprint(
    structure: Any, si: Any, ray: Ray, state: RayDifferential, cos: Any, changes: tuple[Any, Any], dx: Any, dy: Any
) -> tuple[Footprint, Trust]:
    """The footprint for derivatives ``dx`` and ``dy`` of uv, where the cosine ``cos`` at the surface changes by
    ``changes`` to the right and down."""
    edge, shrink_x, shrink_y = vanishing(cos, *changes)
    flags = state.flags | flag(edge & si.valid, SILHOUETTE)
    folded, grow_x, grow_y = folding(ray, state, si)
    dx, dy = dx * (shrink_x * grow_x), dy * (shrink_y * grow_y)
    footprint = finished(structure, si, dx, dy, flags | flag(folded & si.valid, FOLDED))
    return footprint, Trust(flags, shrink_x, shrink_y)


def trusted_ray(
    trust: Trust, lobe: Lobe, sample: Any, cos: Any, changes: tuple[Any, Any], moved: RayDifferential, ray: Ray,
    spacing: float,
) -> RayDifferential:  # fmt: skip
    """The differentials of ``ray``, which leaves a surface: ``moved`` has the derivatives of its map, and ``cos``, its
    cosine there, changes by ``changes``."""
    flags, x, y = trust.flags, trust.x, trust.y
    d_dx, d_dy = moved.d_dx, moved.d_dy
    if lobe.ratio is not None:
        total, shrink_x, shrink_y = vanishing(cos, *changes)
        flags = flags | flag(total & lobe.transmitted, TOTAL_REFLECTION)
        d_dx = dr.select(lobe.transmitted, d_dx * shrink_x, d_dx)
        d_dy = dr.select(lobe.transmitted, d_dy * shrink_y, d_dy)
    flags = flags | flag(~sample.delta, WIDENED)
    wide_x, wide_y = widened(ray.d, sample.pdf, spacing)
    return RayDifferential(
        _finite(moved.o_dx * x),
        dr.select(sample.delta, _finite(d_dx * x), wide_x),
        _finite(moved.o_dy * y),
        dr.select(sample.delta, _finite(d_dy * y), wide_y),
        flags,
    )


def vanishing(cos: Any, change_x: Any, change_y: Any) -> tuple[Any, Any, Any]:
    """Whether ``cos`` would change by more than itself (Bool), and by what to shrink its changes."""
    cos, x, y = abs(cos), abs(change_x), abs(change_y)

    def shrink(change: Any) -> Any:
        return dr.select(change > cos, dr.sqrt(cos / dr.select(change > 0, change, 1)), 1)

    return x + y >= cos, shrink(x), shrink(y)


def finished(structure: Any, si: Any, dx: Any, dy: Any, flags: Any) -> Footprint:
    """The footprint of ``dx`` and ``dy``, finite and with no angle beyond a turn."""
    dx, dy = _bounded(dx), _bounded(dy)
    turns = angles(structure, si)
    if turns is not None:
        seam, around_u, around_v = turns(dx, dy)
        flags = flags | flag(seam & si.valid, SEAM)
        dx, dy = (_turned(v, around_u, around_v) for v in (dx, dy))
    return Footprint(dr.select(si.valid, dx, 0), dr.select(si.valid, dy, 0), flags=dr.select(si.valid, flags, 0))


def angles(structure: Any, si: Any) -> Any:
    """None where no surface has an angle for a coordinate; else what tells, for a footprint, whether a seam or a pole
    is within it, and where u and where v is an angle (Bools)."""
    shading = structure.geometry.shading
    kinds = [k for k in shading.quadric_kinds if k in (record.SPHERE, record.DISK, record.CYLINDER)]
    if not kinds:
        return None
    code = kind_code(shading, si)

    def turns(dx: Any, dy: Any) -> tuple[Any, Any, Any]:
        reach = abs(dx) + abs(dy)
        u, v = si.uv.x, si.uv.y
        ball, disk = code == record.SPHERE, code == record.DISK
        around_u = ball | (code == record.CYLINDER)
        seam = around_u & (dr.fmin(u, 1 - u) <= reach.x)
        seam |= ball & (dr.fmin(v, 1 - v) <= reach.y)
        seam |= disk & ((u <= reach.x) | (dr.fmin(v, 1 - v) <= reach.y))
        return seam, around_u, disk

    return turns


def flag(where: Any, bit: int) -> Any:
    """``bit`` (UInt) where the Bool ``where``."""
    return dr.select(where, dr.uint32_array_t(type(where))(bit), 0)


def folding(ray: Ray, state: RayDifferential, si: Any) -> tuple[Any, Any, Any]:
    """Where neighbouring rays cross (Bool), and by what to lengthen changes to the right and down that fall short."""
    t = dr.select(si.valid, si.t, 0)
    x, y = state.d_dx * t, state.d_dy * t
    # det(o + t d) in the plane across the ray, as the sum of three triple products.
    start = dr.dot(ray.d, dr.cross(state.o_dx, state.o_dy))
    mixed = dr.dot(ray.d, dr.cross(state.o_dx, y) + dr.cross(x, state.o_dy))
    spread = dr.dot(ray.d, dr.cross(x, y))
    terms = abs(start) + abs(mixed) + abs(spread)
    folded = abs(start + mixed + spread) < CANCELLED * terms

    def grow(o: Any, td: Any) -> Any:
        length = dr.squared_norm(o + td)
        least = (dr.squared_norm(o) + dr.squared_norm(td)) * CANCELLED**2
        return dr.select(length < least, dr.sqrt(least / dr.select(length > 0, length, 1)), 1)

    return folded, grow(state.o_dx, x), grow(state.o_dy, y)


def _turned(v: Any, around_u: Any, around_v: Any) -> Any:
    once = type(v)(dr.fmax(dr.fmin(v.x, 1), -1), dr.fmax(dr.fmin(v.y, 1), -1))
    return type(v)(dr.select(around_u, once.x, v.x), dr.select(around_v, once.y, v.y))


def _bounded(v: Any) -> Any:
    v = _finite(v)
    return type(v)(*(dr.fmax(dr.fmin(c, LONGEST), -LONGEST) for c in v))


def _finite(v: Any) -> Any:
    return dr.select(dr.all(dr.isfinite(v)), v, 0)
