"""The second phase of a ray query: from the number of what was met to its position, normals, uv and derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..live import Live, Slot
from ..types import Types, types_of
from . import local_geometry, record
from .frame import Frame, coordinate_system
from .hit import Hit
from .instance import Instance
from .interaction import SurfaceInteraction
from .local_geometry import LocalGeometry, RayPoint
from .magnitude import powers_of_two, unit
from .mesh import TriangleMesh
from .quadrics import Quadric
from .shading_slots import shading_slots
from .surface import Surface

HAS_NORMALS, HAS_UV = 1, 2


class Shading:
    """Buffers for every surface of a geometry. Only kinds that are present add operations to :meth:`interact`."""

    def __init__(self, surfaces: Sequence[Surface], instances: Sequence[Instance], types: Types) -> None:
        self.types = types
        #: Whatever others make once of the same surfaces, by keys of theirs.
        self.kept: dict[Any, Any] = {}
        #: Of each surface, if it is a mesh, where its vertices begin.
        self.first_vertex: list[int] = []
        meshes = [s for s in surfaces if isinstance(s, TriangleMesh)]
        self.quadric_kinds = tuple(sorted({s.KIND for s in surfaces if isinstance(s, Quadric)}))
        self.has_meshes = bool(meshes)
        self.has_uv = any(m.uv is not None for m in meshes)
        self.all_uv = all(m.uv is not None for m in meshes)
        self.has_normals = any(m.normals is not None for m in meshes)
        self.all_normals = all(m.normals is not None for m in meshes)
        if meshes:
            self._upload_meshes(surfaces)
        if self.quadric_kinds:
            self._upload_quadrics(surfaces)
        # Hits come from users too: an index that is not there is a miss, not a read past the end of a buffer.
        self.surface_count = dr.opaque(types.UInt, len(surfaces))
        self.instance_count = dr.opaque(types.UInt, len(instances))
        self.has_instances = bool(instances)
        if instances:
            rows = [np.concatenate([_rows(i.to_world), _rows(np.linalg.inv(i.to_world))]) for i in instances]
            self.instance_rows = owned(np.stack(rows), types.Float)

    def _upload_meshes(self, surfaces: Sequence[Surface]) -> None:
        first_face, faces, vertices, normals, uvs = [], [], [], [], []
        face_count = vertex_count = 0
        for surface in surfaces:
            first_face.append(face_count)
            self.first_vertex.append(vertex_count)
            if not isinstance(surface, TriangleMesh):
                continue
            n = len(surface.vertices)
            flags = HAS_NORMALS * (surface.normals is not None) + HAS_UV * (surface.uv is not None)
            quads = np.empty((len(surface.faces), 4), np.uint32)
            quads[:, :3] = surface.faces + np.uint32(vertex_count)
            quads[:, 3] = flags
            faces.append(quads)
            vertices.append(_padded(surface.vertices, n, 4))
            normals.append(_padded(surface.normals, n, 4))
            uvs.append(_padded(surface.uv, n, 2))
            face_count += len(quads)
            vertex_count += n
        UInt, Float = self.types.UInt, self.types.Float
        self.first_face = owned(np.array(first_face, dtype=np.uint32), UInt)
        self.face_count = dr.opaque(UInt, face_count)
        self.many_surfaces = len(surfaces) > 1
        self.faces = owned(np.concatenate(faces), UInt)
        self.vertices = owned(np.concatenate(vertices), Float)
        if self.has_normals:
            self.normals = owned(np.concatenate(normals), Float)
        if self.has_uv:
            self.uvs = owned(np.concatenate(uvs), Float)

    def _upload_quadrics(self, surfaces: Sequence[Surface]) -> None:
        rows = np.zeros((len(surfaces), 32))
        for k, surface in enumerate(surfaces):
            if isinstance(surface, Quadric):
                rows[k, :12] = _rows(surface.to_world)
                rows[k, 12] = -1.0 if surface.flip_normals else 1.0
                rows[k, 13] = surface.KIND
                rows[k, 16:28] = _rows(np.linalg.inv(surface.to_world))
        self.quadric_rows = owned(rows, self.types.Float)

    def slots(self, shapes: Sequence[Any], instances: Sequence[Any], live: Live) -> list[Slot]:
        """Those of live geometry; ``shapes`` and ``instances`` are the descriptions of the surfaces and instances."""
        return shading_slots(self, shapes, instances, live)

    def interact(self, ray: Any, hit: Hit) -> SurfaceInteraction:
        """The interaction of each ray with what it met; lanes that missed hold zeros and t = inf."""
        types = self.types
        valid = hit.surface < self.surface_count
        instanced = valid & (hit.instance < self.instance_count) if self.has_instances else None
        if self.has_instances:
            to_world, to_local = self._instance_maps(hit, instanced)
            o, d = to_local.point(ray.o), to_local.vector(ray.d)
        else:
            o, d = ray.o, ray.d
        if not (self.has_meshes or self.quadric_kinds):
            return _nothing(types, ray, hit)
        t = hit.t
        geometry = self._local_geometry(dr.detach(o), dr.detach(d), t, hit, valid)
        if dr.grad_enabled(o, d, geometry.p):
            # To first order the ray meets what it met where it meets the tangent plane, which goes along with the point
            # of the surface that is there now.
            n, p = dr.detach(geometry.n), geometry.p
            slope = dr.dot(n, d)
            t = dr.replace_grad(t, dr.dot(n, p - o) / dr.select(valid & (slope != 0), slope, 1))
            geometry = self._local_geometry(o, d, t, hit, valid)
        if self.has_instances:
            geometry = geometry.transformed(to_world, to_local)
        return _finish(geometry, ray, t, hit, valid, types)

    def _local_geometry(self, o: Any, d: Any, t: Any, hit: Hit, valid: Any) -> LocalGeometry:
        """The geometry at ``o + t d``, with ``o`` and ``d`` in the coordinates of the surface that each ray met."""
        types = self.types
        t = dr.select(valid, t, 0)
        p = dr.fma(d, t, o)
        kinds: list[tuple[Any, LocalGeometry]] = []
        is_quadric: Any = types.Bool(False)
        if self.quadric_kinds:
            world = dr.gather(types.ArrayXf, self.quadric_rows, hit.surface * 2, valid, shape=(16, dr.width(hit.t)))
            local = dr.gather(types.ArrayXf, self.quadric_rows, hit.surface * 2 + 1, valid, shape=(16, dr.width(hit.t)))
            code = types.UInt(world[13])
            is_quadric = valid & (code != record.TRIANGLE)
            size, per_size = powers_of_two(dr.detach(d))
            at = dr.detach(t) * size
            met = RayPoint(p, o, d * per_size, at, abs(at) * (8 * types.epsilon))
            for kind in self.quadric_kinds:
                found = local_geometry.QUADRICS[kind](met, hit.uv, Rows(world), Rows(local), world[12])
                kinds.append((is_quadric & (code == kind), found))
        if self.has_meshes:
            on_mesh = valid & ~is_quadric
            kinds.append((on_mesh, self._on_triangle(p, hit, on_mesh)))
        geometry = kinds[0][1]
        for mask, other in kinds[1:]:
            pairs = zip(geometry.fields(), other.fields(), strict=True)
            # What neither kind has needs no choice.
            geometry = LocalGeometry(*(a if a is b else dr.select(mask, b, a) for a, b in pairs))
        return geometry

    def _instance_maps(self, hit: Hit, instanced: Any) -> tuple[Rows, Rows]:
        types = self.types
        identity = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]
        maps = []
        for k in range(2):
            words: list[Any] = []
            for row in range(3):
                words.extend(dr.gather(types.Array4f, self.instance_rows, hit.instance * 6 + 3 * k + row, instanced))
            maps.append(Rows([dr.select(instanced, w, i) for w, i in zip(words, identity, strict=True)]))
        return maps[0], maps[1]

    def _on_triangle(self, p: Any, hit: Hit, active: Any) -> LocalGeometry:
        types = self.types
        face = hit.prim
        if self.many_surfaces:
            face = face + dr.gather(types.UInt, self.first_face, hit.surface, active)
        active &= face < self.face_count
        i0, i1, i2, flags = dr.gather(types.Array4u, self.faces, face, active)

        def corner(buffer: Any, index: Any) -> Any:
            q = dr.gather(types.Array4f, buffer, index, active)
            return types.Array3f(q.x, q.y, q.z)

        positions = [corner(self.vertices, i) for i in (i0, i1, i2)]
        normals = uvs = None
        smooth: Any = False
        textured: Any = False
        if self.has_normals:
            normals = [corner(self.normals, i) for i in (i0, i1, i2)]
            smooth = True if self.all_normals else (flags & HAS_NORMALS) != 0
        if self.has_uv:
            uvs = [dr.gather(types.Array2f, self.uvs, i, active) for i in (i0, i1, i2)]
            textured = True if self.all_uv else (flags & HAS_UV) != 0
        return local_geometry.on_triangle(p, positions, normals, uvs, smooth, textured, hit.uv)


class Rows:
    """The rows of an affine map, a Float each, per lane."""

    def __init__(self, words: Any) -> None:
        self.rows = [[words[4 * k + j] for j in range(4)] for k in range(3)]

    def point(self, p: Any) -> Any:
        """The image of a point."""
        return type(p)(*(dr.fma(a, p.x, dr.fma(b, p.y, dr.fma(c, p.z, t))) for a, b, c, t in self.rows))

    def vector(self, v: Any) -> Any:
        """The image of a direction."""
        return type(v)(*(dr.fma(a, v.x, dr.fma(b, v.y, c * v.z)) for a, b, c, _ in self.rows))

    def transposed(self, v: Any) -> Any:
        """``v`` under the transposed linear part: a normal, if these are the rows of the inverse map."""
        r = self.rows
        return type(v)(*(dr.fma(r[0][k], v.x, dr.fma(r[1][k], v.y, r[2][k] * v.z)) for k in range(3)))

    def error(self, p: Any, error: Any) -> Any:
        """A bound on the rounding error, per component, of :meth:`point` at a point known to within ``error``, with
        room for the rounded matrix and for a ray test that works with its inverse."""
        at = abs(p) + error
        sizes = []
        for a, b, c, t in self.rows:
            sizes.append((abs(a) * at.x + abs(b) * at.y + abs(c) * at.z + abs(t)) * (16 * types_of(p).epsilon))
        grown = [(abs(a) + abs(b) + abs(c)) * error for a, b, c, _ in self.rows]
        total = [s + g for s, g in zip(sizes, grown, strict=True)]
        return dr.fmax(dr.fmax(total[0], total[1]), total[2])

    def spread(self, p: Any, units: int = 16) -> Any:
        """A bound on the rounding error, per component, of the image of ``p`` relative to the centre, of ``units`` of
        round-off: for the rounded linear part, and for a ray test that works with its inverse."""
        sizes = [abs(a * p.x) + abs(b * p.y) + abs(c * p.z) for a, b, c, _ in self.rows]
        return dr.fmax(dr.fmax(sizes[0], sizes[1]), sizes[2]) * (units * types_of(p).epsilon)

    @property
    def even_scale(self) -> Any:
        """By how much a linear part scales that does so evenly in all directions, but for rounding: as the ray test of
        spheres has it."""
        columns = [r[k] for r in self.rows for k in range(3)]
        largest = abs(columns[0])
        for entry in columns[1:]:
            largest = dr.fmax(largest, abs(entry))
        size, per_size = powers_of_two(types_of(largest).Array3f(largest))
        square: Any = 0
        for entry in columns:
            square = dr.fma(entry * per_size, entry * per_size, square)
        return dr.sqrt(dr.select(square > 0, square * (1 / 3), 1)) * size

    @property
    def translation(self) -> list[Any]:
        """The translation part."""
        return [row[3] for row in self.rows]


def _finish(g: LocalGeometry, ray: Any, t: Any, hit: Hit, valid: Any, types: Types) -> SurfaceInteraction:
    s = g.dp_du - g.sh_n * dr.dot(g.sh_n, g.dp_du)
    # Where the parameterisation is singular any tangent will do.
    any_s, _ = coordinate_system(g.sh_n)
    s = dr.select(dr.any(s != 0), unit(s), any_s)
    frame = Frame(s, dr.cross(g.sh_n, s), g.sh_n)
    zero3 = types.Array3f(0)
    return SurfaceInteraction(
        valid=valid,
        t=t,
        p=dr.select(valid, g.p, zero3),
        n=dr.select(valid, g.n, zero3),
        sh_frame=Frame(*(dr.select(valid, v, zero3) for v in (frame.s, frame.t, frame.n))),
        uv=dr.select(valid, g.uv, types.Array2f(0)),
        dp_du=dr.select(valid, g.dp_du, zero3),
        dp_dv=dr.select(valid, g.dp_dv, zero3),
        prim_uv=hit.uv,
        wi=dr.select(valid, frame.to_local(-ray.d), -ray.d),
        prim=hit.prim,
        surface=hit.surface,
        instance=hit.instance,
        p_error=dr.select(valid, g.error, 0),
        p_rest=dr.select(valid, g.rest, zero3),
        p_span=g.span if isinstance(g.span, float) else dr.select(valid, g.span, zero3),
    )


def _nothing(types: Types, ray: Any, hit: Hit) -> SurfaceInteraction:
    width = dr.width(hit.t)
    zero3 = dr.zeros(types.Array3f, width)
    zero2 = dr.zeros(types.Array2f, width)
    none = dr.full(types.UInt, record.NONE, width)
    frame = Frame(zero3, zero3, zero3)
    invalid = dr.full(types.Bool, False, width)
    error = dr.zeros(types.Float, width)
    return SurfaceInteraction(
        invalid, hit.t, zero3, zero3, frame, zero2, zero3, zero3, zero2, -ray.d, none, none, none, error, zero3
    )


def _rows(matrix: np.ndarray) -> np.ndarray:
    return np.asarray(matrix)[:3].ravel()


def _padded(values: np.ndarray | None, count: int, columns: int) -> np.ndarray:
    out = np.zeros((count, columns))
    if values is not None:
        out[:, : values.shape[1]] = values
    return out
