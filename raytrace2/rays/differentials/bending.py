"""How shading normals turn along a surface: the shape operator of each kind, derived by hand."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ...surfaces import record
from ...surfaces.magnitude import powers_of_two
from ...surfaces.shading import HAS_NORMALS, Rows
from ...types import types_of


class Bending:
    """Of what each ray met at ``si``, in ``structure``.

    Spheres turn by the way over their radius, cylinders so around their axis, meshes as their interpolated normals do,
    and planes nowhere. Under instances the normals of the group are mapped. What ``si`` carries derivatives of, the
    result does too.
    """

    def __init__(self, structure: Any, si: Any) -> None:
        self._shading = structure.geometry.shading
        self._types = structure.types
        self._si = si
        self._n = si.sh_frame.n
        self._place = instance_maps(self._shading, si) if self._shading.has_instances else None
        kinds = self._shading.quadric_kinds
        round_kinds = [k for k in kinds if k in (record.SPHERE, record.CYLINDER)]
        self._code = kind_code(self._shading, si) if round_kinds else None
        p, n = si.p, self._n
        if self._place is not None:
            to_world, to_local = self._place
            p, n = to_local.point(p), to_world.transposed(n)
            # The normal in the group, and what its map to the world multiplies lengths by.
            self._length = dr.rsqrt(_safe(dr.squared_norm(n)))
            n = n * self._length
        self._mesh = None
        if self._shading.has_meshes and self._shading.has_normals:
            self._mesh = _SmoothTriangle(self._shading, self._types, si, p)
        self._round = None
        if round_kinds:
            self._round = _Round(self._shading, si, round_kinds, self._code, p, n)

    def along(self, dp: Any) -> Any:
        """The derivative of the unit shading normal for a step ``dp`` in the tangent plane."""
        zero = type(dp)(0)
        if self._mesh is None and self._round is None:
            return zero
        if self._place is not None:
            dp = self._place[1].vector(dp)
        result = zero
        if self._mesh is not None:
            result = self._mesh.along(dp)
        if self._round is not None:
            result = self._round.along(dp, result)
        if self._place is not None:
            result = self._place[1].transposed(result) * dr.rcp(self._length)
            result = dr.fma(self._n, -dr.dot(self._n, result), result)
        return dr.select(self._si.valid, result, 0)


class _Round:
    """Spheres and cylinders, in the coordinates of their group."""

    def __init__(self, shading: Any, si: Any, kinds: list[int], code: Any, p: Any, n: Any) -> None:
        self._kinds, self._code, self._n = kinds, code, n
        words = quadric_words(shading, si, 0)
        self._side = words[12]
        if record.SPHERE in kinds:
            a, b, c, _ = Rows(words).rows[0]
            self._per_radius = self._side * dr.rsqrt(_safe(dr.fma(a, a, dr.fma(b, b, c * c))))
        if record.CYLINDER in kinds:
            self._to_local = Rows(quadric_words(shading, si, 1))
            at = self._to_local.point(p)
            # The normal maps from the radial unit vector, whose image has this length.
            radial = self._to_local.transposed(type(p)(at.x, at.y, 0))
            self._per_length = self._side * dr.rsqrt(_safe(dr.squared_norm(radial)))

    def along(self, dp: Any, other: Any) -> Any:
        """The turn on these; ``other`` elsewhere."""
        if record.SPHERE in self._kinds:
            other = dr.select(self._code == record.SPHERE, dp * self._per_radius, other)
        if record.CYLINDER in self._kinds:
            local = self._to_local.vector(dp)
            turn = self._to_local.transposed(type(dp)(local.x, local.y, 0)) * self._per_length
            turn = dr.fma(self._n, -dr.dot(self._n, turn), turn)
            other = dr.select(self._code == record.CYLINDER, turn, other)
        return other


class _SmoothTriangle:
    """Triangles with normals at their vertices, in the coordinates of their group."""

    def __init__(self, shading: Any, types: Any, si: Any, p: Any) -> None:
        active, face = si.valid, si.prim
        if shading.quadric_kinds:
            active = active & (kind_code(shading, si) == record.TRIANGLE)
        if shading.many_surfaces:
            face = face + dr.gather(types.UInt, shading.first_face, si.surface, active)
        active &= face < shading.face_count
        *corners, flags = dr.gather(types.Array4u, shading.faces, face, active)

        def at(buffer: Any, index: Any) -> Any:
            q = dr.gather(types.Array4f, buffer, index, active)
            return types.Array3f(q.x, q.y, q.z)

        p0, p1, p2 = (at(shading.vertices, i) for i in corners)
        n0, n1, n2 = (at(shading.normals, i) for i in corners)
        e1, e2 = p1 - p0, p2 - p0
        self._per_size = powers_of_two(dr.fmax(abs(e1), abs(e2)))[1]
        e1, e2 = e1 * self._per_size, e2 * self._per_size
        across = dr.cross(e1, e2)
        inverse = dr.rcp(_safe(dr.squared_norm(across)))
        self._to_b1, self._to_b2 = dr.cross(e2, across) * inverse, dr.cross(across, e1) * inverse
        self._n1, self._n2 = n1 - n0, n2 - n0
        b = dr.detach(si.prim_uv)
        if dr.grad_enabled(p):
            arm = (p - p0) * self._per_size
            b = dr.replace_grad(b, type(b)(dr.dot(arm, self._to_b1), dr.dot(arm, self._to_b2)))
        blend = dr.fma(self._n1, b.x, dr.fma(self._n2, b.y, n0))
        length = dr.squared_norm(blend)
        usable = active & (length > 0)
        if not shading.all_normals:
            usable &= (flags & HAS_NORMALS) != 0
        self._usable = usable
        self._per_length = dr.rsqrt(dr.select(usable, length, 1))
        self._blend = blend * self._per_length

    def along(self, dp: Any) -> Any:
        """The turn of the blended normal."""
        dp = dp * self._per_size
        turn = dr.fma(self._n1, dr.dot(dp, self._to_b1), self._n2 * dr.dot(dp, self._to_b2)) * self._per_length
        return dr.select(self._usable, dr.fma(self._blend, -dr.dot(self._blend, turn), turn), 0)


def kind_code(shading: Any, si: Any) -> Any:
    """Which kind of primitive each ray met (UInt, as in :mod:`~raytrace2.surfaces.record`; 0 for triangles)."""
    return type(si.surface)(quadric_words(shading, si, 0)[13])


def quadric_words(shading: Any, si: Any, row: int) -> Any:
    """Sixteen Floats of what each ray met: for ``row`` 0 its map to the world, 1 or -1 for normals that face out or in,
    and its kind; for ``row`` 1 the inverse map. The packet that the interaction was made of, so read once."""
    index = si.surface * 2 + row if row else si.surface * 2
    return dr.gather(types_of(si.t).ArrayXf, shading.quadric_rows, index, si.valid, shape=(16, dr.width(si.t)))


def instance_maps(shading: Any, si: Any) -> tuple[Any, Any]:
    """From the group to the world and back, for each ray; the identity where it met no instance."""
    instanced = si.valid & (si.instance < shading.instance_count)
    return shading._instance_maps(si, instanced)


def _safe(x: Any) -> Any:
    return dr.select(x > 0, x, 1)
