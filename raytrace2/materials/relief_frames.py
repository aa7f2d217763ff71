"""The shading frames that bump and normal maps give a surface, as Mitsuba's ``bumpmap`` and ``normalmap`` do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..scene.description import BitmapTexture, BumpMapBsdf, NormalMapBsdf
from ..surfaces.frame import Frame, coordinate_system
from ..surfaces.interaction import Grain
from ..textures import TextureTable
from ..textures.bitmap import Bitmaps
from .bump import Heights, linear_pixels, tangent_slopes
from .relief import Relief
from .relief_moments import ReliefMoments, blended

_NONE, _BUMP, _NORMAL = range(3)
_BEHIND, _FLIP, _SHADOW = 4, 8, 16


@dataclass
class ReliefFrame:
    """``frame``: the frame (Frame) that a map gives, within the shading frame of the surface; ``mapped`` (Bool): where
    there is a map at all; ``shadows`` (Bool): where grazing light is attenuated."""

    frame: Frame
    mapped: Any
    shadows: Any

    def to_local(self, v: Any) -> Any:
        """From the shading frame of the surface to the map's."""
        return dr.select(self.mapped, self.frame.to_local(v), v)

    def to_world(self, v: Any) -> Any:
        """From the map's frame to the shading frame of the surface."""
        return dr.select(self.mapped, self.frame.to_world(v), v)

    def passes(self, inner: Any, outer: Any) -> Any:
        """Whether a direction, in the map's frame and in that of the surface, is on the same side of both (Bool)."""
        return ~self.mapped | (inner.z * outer.z > 0)

    def shadowing(self, wo: Any) -> Any:
        """What attenuates light along ``wo`` (in the frame of the surface), so that it ends smoothly where the surface
        turns away (Estevez, Lecocq and Stein 2019, Ray Tracing Gems, chapter 12)."""
        alpha2 = dr.fmin(0.125 * _tan2(self.frame.n), 1)
        return dr.select(self.shadows, 2 / (1 + dr.sqrt(1 + alpha2 * _tan2(wo))), 1)


class ReliefFrames:
    """``entries[i]``: the map of side ``i``, or None. With a filter that heeds footprints (in the settings of
    ``textures``) frames are those of normals drawn from what the footprint covers: see :mod:`.relief_moments`."""

    def __init__(self, entries: Sequence[Relief | None], textures: TextureTable) -> None:
        types = self._types = textures.types
        bumps = _unique([r.bsdf for r in entries if r and isinstance(r.bsdf, BumpMapBsdf)])
        normals = _unique([r.bsdf for r in entries if r and isinstance(r.bsdf, NormalMapBsdf)])
        self._heights = Heights([b.texture for b in bumps], types) if bumps else None
        images = _one_format([b.normalmap for b in normals])
        settings = textures.settings
        self._moments: ReliefMoments | None = None
        point = settings
        if settings is not None and settings.needs_footprint:
            self._moments = ReliefMoments([b.texture for b in bumps], images, types, settings)
            point = None
        self._normals = Bitmaps(images, types, point) if images else None
        if settings is not None and settings.name == "nearest" and bumps:
            raise_flat = [replace(b, scale=0.0) for b in bumps]
        else:
            raise_flat = bumps
        flags, places, scales = [], [], []
        for relief in entries:
            bump = relief is not None and isinstance(relief.bsdf, BumpMapBsdf)
            among: list[Any] = bumps if bump else normals
            place = 0 if relief is None else [id(b) for b in among].index(id(relief.bsdf))
            places.append(place)
            flags.append(_flags(relief))
            scales.append(raise_flat[place].scale if bump else 1.0)
        self._flags = flags
        self._single = len(entries) == 1
        self._count_bumps = len(bumps)
        records = np.array([flags, places], dtype=np.uint32).T
        self._records: Any = (
            [owned(records[0, k], types.UInt) for k in (0, 1)] if self._single else owned(records, types.UInt)
        )
        self._unscaled = all(scale == 1 for scale in scales)
        self._scales = owned(np.array(scales, dtype=types.numpy), types.Float)

    def at(self, si: Any, wi: Any, entry: Any, active: Any) -> ReliefFrame:
        """The frame at ``si`` seen from ``wi`` (in the shading frame, on the side of ``entry``)."""
        t = self._types
        flags, place = self._record(entry, active)
        mapped = self._is(flags, 3, (_BUMP, _NORMAL))
        n, s = t.Array3f(0, 0, 1), t.Array3f(1, 0, 0)
        behind = self._is(flags, _BEHIND, (_BEHIND,))
        grain = Grain(si.uv, si.dp_du, si.dp_dv) if si.grain is None else si.grain
        if self._heights is not None:
            here = self._is(flags, 3, (_BUMP,))
            n, s = self._bumped(si, grain, entry, place, active & here)
        if self._normals is not None:
            here = self._is(flags, 3, (_NORMAL,))
            found = self._normal_mapped(si, grain, place, active & here)
            n, s = (dr.select(here, a, b) for a, b in zip(found, (n, s), strict=True)) if self._heights else found
        if any(f & _BEHIND for f in self._flags):
            n = t.Array3f(dr.select(behind, -n.x, n.x), dr.select(behind, -n.y, n.y), n.z)
            s = t.Array3f(s.x, s.y, dr.select(behind, -s.z, s.z))
        if any(f & _FLIP for f in self._flags):
            away = self._is(flags, _FLIP, (_FLIP,)) & (wi.z * dr.dot(wi, n) <= 0)
            n = t.Array3f(dr.select(away, -n.x, n.x), dr.select(away, -n.y, n.y), n.z)
        s = s - n * dr.dot(n, s)
        # A tangent along the normal, or none at all, leaves any.
        length2 = dr.squared_norm(s)
        usable = length2 > t.epsilon
        s = dr.select(usable, s * dr.rsqrt(dr.select(usable, length2, 1)), coordinate_system(n)[0])
        frame = Frame(s, dr.cross(n, s), n)
        return ReliefFrame(frame, mapped, mapped & self._is(flags, _SHADOW, (_SHADOW,)))

    def _bumped(self, si: Any, grain: Grain, entry: Any, place: Any, active: Any) -> tuple[Any, Any]:
        t = self._types
        assert self._heights is not None
        scale = None if self._unscaled else self._scale(entry, active)
        gradient = self._heights.gradient(place, grain.uv, active)
        gradient = gradient if scale is None else gradient * scale
        dp_du, dp_dv = si.to_local(grain.dp_du), si.to_local(grain.dp_dv)
        along_u, along_v = tangent_slopes(dp_du, dp_dv)
        slope = along_u * gradient.x + along_v * gradient.y
        n = _unit(t.Array3f(-slope.x, -slope.y, 1))
        if self._moments is not None and si.footprint is not None:
            axes = (along_u, along_v) if scale is None else (along_u * scale, along_v * scale)
            n = blended(n, self._moments.bumps(self._heights, place, si, axes, active))
        n_g = si.to_local(si.n)
        n = n * dr.mulsign(t.Float(1), dr.dot(n_g, n))
        # Mitsuba takes the world's dp_du for one in the shading frame; only anisotropic materials show it.
        return n, si.dp_du

    def _normal_mapped(self, si: Any, grain: Grain, place: Any, active: Any) -> tuple[Any, Any]:
        t = self._types
        assert self._normals is not None
        n = _unit(self._normals.eval(place, grain.uv, None, active) * 2 - 1)
        if self._moments is not None and si.footprint is not None:
            n = blended(n, self._moments.normals(place, si, active))
        s = t.Array3f(1, 0, 0)
        return (n, s) if si.grain is None else (_twisted(n, si, grain), _twisted(s, si, grain))

    def _record(self, entry: Any, active: Any) -> Any:
        t = self._types
        if self._single:
            return self._records
        pair = dr.gather(t.Array2u, self._records, entry, active)
        return pair.x, pair.y

    def _scale(self, entry: Any, active: Any) -> Any:
        if self._single:
            return self._scales
        return dr.select(active, dr.gather(self._types.Float, self._scales, entry, active), 1)

    def _is(self, flags: Any, mask: int, values: tuple[int, ...]) -> Any:
        known = {f & mask in values for f in self._flags}
        if len(known) == 1:
            return self._types.Bool(known.pop())
        result = self._types.Bool(False)
        for value in values:
            result = result | (flags & mask == value)
        return result


def _flags(relief: Relief | None) -> int:
    if relief is None:
        return _NONE
    b = relief.bsdf
    kind = _BUMP if isinstance(b, BumpMapBsdf) else _NORMAL
    return kind | _BEHIND * relief.behind | _FLIP * b.flip_invalid_normals | _SHADOW * b.use_shadowing_function


def _unique(bsdfs: Sequence[Any]) -> list[Any]:
    return list({id(b): b for b in bsdfs}.values())


def _one_format(textures: Sequence[Any]) -> list[BitmapTexture]:
    """Normal maps in one storage format: their own if they share it."""
    for texture in textures:
        if not isinstance(texture, BitmapTexture) or texture.pixels.shape[2] != 3:
            raise ValueError("a normal map must be a bitmap of three channels")
    if len({t.pixels.dtype for t in textures}) > 1:
        return [replace(t, pixels=linear_pixels(t), raw=True) for t in textures]
    return list(textures)


def _unit(n: Any) -> Any:
    length2 = dr.squared_norm(n)
    usable = (length2 > 0) & dr.isfinite(length2)
    return dr.select(usable, n * dr.rsqrt(dr.select(usable, length2, 1)), type(n)(0, 0, 1))


def _twisted(v: Any, si: Any, grain: Grain) -> Any:
    """``v`` with derivatives that follow the direction of ``dp_du`` about the shading normal."""
    along = si.to_local(grain.dp_du)
    length2 = along.x * along.x + along.y * along.y
    regular = length2 > 0
    inverse = dr.rsqrt(dr.select(regular, length2, 1))
    cosine, sine = dr.select(regular, along.x * inverse, 1), dr.select(regular, along.y * inverse, 0)
    turned = type(v)(v.x * cosine - v.y * sine, v.x * sine + v.y * cosine, v.z)
    return dr.replace_grad(v, turned)


def _tan2(v: Any) -> Any:
    cos2 = v.z * v.z
    some = cos2 > 0
    return dr.select(some, dr.fmax(1 - cos2, 0) / dr.select(some, cos2, 1), 1e30)
