"""On which side of a ray an edge passes, where rounding could hide it: determinants in twice the digits of float64.

A coordinate less another is two numbers, without loss; products of two such and a component of a direction are summed
with what their rounding loses. In float32 the sign is then that of the exact determinant, and zero means zero, unless
coordinates of one triangle less the ray's origin span some forty bits; in float64 the error is 2^-100 of the terms.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..types import types
from .compensated import two_product, two_sum
from .ordered import greater, lesser

#: A number and what it leaves of the exact value.
Pair = tuple[Any, Any]


def meeting_in_float64(words: list[Any], ray: Any, doubtful: Any) -> tuple[Any, Any, Any, Any]:
    """Whether float32 rays meet the triangle ``words[0:9]``, t, and the weights of its vertices 1 and 2, rounded once.

    Lanes that are not ``doubtful`` meet it for sure.
    """
    Vector, Float = types("float64").Array3f, type(words[0])
    a, b, c = (Vector(*words[k : k + 3]) for k in (0, 3, 6))
    d = Vector(*ray.d)
    ab, ac, oa = b - a, c - a, a - Vector(*ray.o)
    normal, moment = dr.cross(ab, ac), dr.cross(d, oa)
    slope = dr.dot(normal, d)
    per_slope = dr.rcp(slope)
    t, v, w = dr.dot(normal, oa) * per_slope, -dr.dot(moment, ac) * per_slope, dr.dot(moment, ab) * per_slope

    def settle(*_: Any) -> tuple[Any, Any, Any, Any]:
        e, f, g = exact_edges(words, ray)
        met, v, w = weights(e, f, g)
        at = oa + ab * v + ac * w
        # Of a ray that all but lies in the plane, which has no digits left for t.
        return met, dr.dot(at, d) * dr.rcp(dr.squared_norm(d)), v, w

    met, t, v, w = dr.if_stmt((slope != 0, t, v, w), doubtful, settle, lambda *sure: sure)
    return met, Float(t), Float(v), Float(w)


def weights(u: Any, v: Any, w: Any) -> tuple[Any, Any, Any]:
    """Whether edge functions are those of a ray that meets the triangle, and the weights of vertices 1 and 2."""
    inside = (lesser(lesser(u, v), w) >= 0) | (greater(greater(u, v), w) <= 0)
    determinant = u + v + w
    met = inside & (determinant != 0)
    per_area = dr.rcp(dr.select(met, determinant, 1))
    return met, v * per_area, w * per_area


def exact_edges(words: list[Any], ray: Any) -> tuple[Any, Any, Any]:
    """The edge functions of vertices 0, 1 and 2 of the triangle ``words[0:9]``, in float64: six times the volume of the
    tetrahedron of the ray's direction and the edge across, as seen from its origin."""
    Float = types("float64").Float
    o, d = [Float(x) for x in ray.o], [Float(x) for x in ray.d]
    a, b, c = ([two_sum(Float(words[k + j]), -o[j]) for j in range(3)] for k in (0, 3, 6))
    return _determinant(d, c, b), _determinant(d, a, c), _determinant(d, b, a)


def _determinant(d: list[Any], m: list[Pair], n: list[Pair]) -> Any:
    total: Any = 0
    rest: Any = 0
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        for sign, (p, p_lost), (q, q_lost) in ((1, m[j], n[k]), (-1, m[k], n[j])):
            product, lost = two_product(p, q)
            lost = dr.fma(p, q_lost, dr.fma(p_lost, q, lost))
            term, lost_term = two_product(sign * d[i], product)
            total, lost_sum = two_sum(total, term)
            rest = rest + (dr.fma(sign * d[i], lost, lost_term) + lost_sum)
    return total + rest
