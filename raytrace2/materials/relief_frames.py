"""The shading frames that bump and normal maps give a surface, as Mitsuba's ``bumpmap`` and ``normalmap`` do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..live import Place, Slot, Values, put
from ..scene.color import linear_pixels
from ..scene.description import BitmapTexture, BumpMapBsdf, NormalMapBsdf
from ..surfaces.frame import Frame, coordinate_system
from ..surfaces.interaction import Grain
from ..textures import TextureTable
from ..textures.bitmap import Bitmaps
from .bump import Heights, tangent_slopes
from .relief import Relief
from .relief_moments import ReliefMoments
from .spread import Slopes, Spread, slope_normal

_NONE, _BUMP, _NORMAL = range(3)
_BEHIND, _FLIP, _SHADOW = 4, 8, 16


@dataclass
class ReliefFrame:
    """``frame``: the frame (Frame) that a map gives, within the shading frame of the surface; ``mapped`` (Bool): where
    there is a map at all; ``shadows`` (Bool): where grazing light is attenuated, by ``tan2``, the squared slope of
    normals; ``spread`` of normals over the footprint, or None."""

    frame: Frame
    mapped: Any
    shadows: Any
    tan2: Any
    spread: Spread | None

    def to_local(self, v: Any) -> Any:
        """From the shading frame of the surface to the map's."""
        return dr.select(self.mapped, self.frame.to_local(v), v)

    def to_world(self, v: Any) -> Any:
        """From the map's frame to the shading frame of the surface."""
        return dr.select(self.mapped, self.frame.to_world(v), v)

    def transmitted(self, inner: Any, outer: Any) -> Any:
        """What is left (Float) of light along a direction, given in the map's frame and in that of the surface.

        Nothing where it is on different sides of the two; else less the more it grazes, so that light ends smoothly
        where the surface turns away (Estevez, Lecocq and Stein 2019, Ray Tracing Gems, chapter 12).
        """
        alpha2 = dr.fmin(0.125 * self.tan2, 1)
        shadowing = dr.select(self.shadows, 2 / (1 + dr.sqrt(1 + alpha2 * _tan2(outer))), 1)
        return dr.select(~self.mapped | (inner.z * outer.z > 0), shadowing, 0)


@dataclass
class Reliefs:
    """Frames for materials that are ``widened`` by a spread of normals, and for others (``drawn``)."""

    widened: ReliefFrame | None
    drawn: ReliefFrame | None

    def of(self, leaf: Any) -> ReliefFrame:
        """That of a table of materials."""
        found = self.widened if leaf.widens else self.drawn
        assert found is not None
        return found


@dataclass
class _Normals:
    """A map's own normal and tangent in the shading frame, and what is known of slopes in the footprint."""

    n: Any
    s: Any
    slopes: Slopes | None = None
    share: Any = None

    def selected(self, mask: Any, other: _Normals) -> _Normals:
        result = _Normals(dr.select(mask, self.n, other.n), dr.select(mask, self.s, other.s))
        if self.slopes is not None and other.slopes is not None:
            result.slopes = self.slopes.selected(mask, other.slopes)
            result.share = dr.select(mask, self.share, other.share)
        return result


class ReliefFrames:
    """``entries[i]``: the map of side ``i``, or None. With a filter that heeds footprints (in the settings of
    ``textures``) frames are those of the normals that footprints cover: see :mod:`.relief_moments`."""

    def __init__(self, entries: Sequence[Relief | None], textures: TextureTable) -> None:
        types = self._types = textures.types
        bumps = _unique([r.bsdf for r in entries if r and isinstance(r.bsdf, BumpMapBsdf)])
        normals = _unique([r.bsdf for r in entries if r and isinstance(r.bsdf, NormalMapBsdf)])
        self._heights = Heights([b.texture for b in bumps], types, textures.live) if bumps else None
        images = _one_format([b.normalmap for b in normals])
        settings = textures.settings
        self._moments: ReliefMoments | None = None
        point = settings
        if settings is not None and settings.needs_footprint:
            self._moments = ReliefMoments(
                [b.texture for b in bumps], [b.normalmap for b in normals], types, settings, textures.live
            )
            point = None
        live = textures.live.standing_for(images, [b.normalmap for b in normals])
        self._normals = Bitmaps(images, types, point, live) if images else None
        self._live_scales: dict[int, Place] = {}
        # The gradient of a nearest texel is zero.
        flat = settings is not None and settings.name == "nearest"
        flags: list[int] = []
        places: list[int] = []
        scales: list[float] = []
        for relief in entries:
            bump = relief is not None and isinstance(relief.bsdf, BumpMapBsdf)
            among: list[Any] = bumps if bump else normals
            place = 0 if relief is None else [id(b) for b in among].index(id(relief.bsdf))
            places.append(place)
            flags.append(_flags(relief))
            if relief and not flat and (scaled := textures.live.place(relief.bsdf, "scale")) is not None:
                self._live_scales[len(scales)] = scaled
            scales.append((0.0 if flat else bumps[place].scale) if bump else 1.0)
        self._flags = flags
        self._single = len(entries) == 1
        records = np.array([flags, places], dtype=np.uint32).T
        self._records: Any = (
            [owned(records[0, k], types.UInt) for k in (0, 1)] if self._single else owned(records, types.UInt)
        )
        self._unscaled = not self._live_scales and all(scale == 1 for scale in scales)
        self._scales = owned(np.array(scales, dtype=types.numpy), types.Float)

    def slots(self) -> list[Slot]:
        """Those of live maps and of how high they are."""

        def make(base: Any, values: Values) -> Any:
            buffer = type(base)(base)
            for k, place in self._live_scales.items():
                put(buffer, k, [values(place)])
            return buffer

        found = self._heights.slots() if self._heights else []
        found += self._normals.slots(moves=True) if self._normals else []
        found += self._moments.slots() if self._moments else []
        if self._live_scales:
            found.append(Slot.of(self, "_scales", self._live_scales.values(), make, moves=True))
        return found

    def at(self, si: Any, wi: Any, entry: Any, active: Any, *, widens: bool = True, draws: bool = True) -> Reliefs:
        """The frames at ``si`` seen from ``wi`` (in the shading frame, on the side of ``entry``): one to widen
        materials in, and one for those that cannot be widened, as far as they are asked for."""
        t = self._types
        flags, place = self._record(entry, active)
        found = _Normals(t.Array3f(0, 0, 1), t.Array3f(1, 0, 0))
        grain = Grain(si.uv, si.dp_du, si.dp_dv) if si.grain is None else si.grain
        if self._heights is not None:
            here = self._is(flags, 3, (_BUMP,))
            found = self._bumped(si, grain, entry, place, active & here)
        if self._normals is not None:
            here = self._is(flags, 3, (_NORMAL,))
            other = self._normal_mapped(si, grain, place, active & here)
            found = other if self._heights is None else other.selected(here, found)
        if found.slopes is None:
            frame = self._frame(flags, wi, found.n, found.s, None)
            return Reliefs(frame, frame)
        widened = drawn = None
        if widens:
            n = _mixed(found.n, found.slopes.normal(), found.share)
            widened = self._frame(flags, wi, n, found.s, found.slopes.fading(found.share))
        if draws:
            drawn = self._frame(flags, wi, _mixed(found.n, found.slopes.drawn(si), found.share), found.s, None)
        return Reliefs(widened, drawn)

    def _frame(self, flags: Any, wi: Any, n: Any, s: Any, slopes: Slopes | None) -> ReliefFrame:
        t = self._types
        if any(f & _BEHIND for f in self._flags):
            behind = self._is(flags, _BEHIND, (_BEHIND,))
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
        mapped = self._is(flags, 3, (_BUMP, _NORMAL))
        tan2 = _tan2(n)
        spread = None
        if slopes is not None:
            tan2 = tan2 + slopes.variance
            spread = slopes.seen_from(frame).where(mapped)
        return ReliefFrame(frame, mapped, mapped & self._is(flags, _SHADOW, (_SHADOW,)), tan2, spread)

    def _bumped(self, si: Any, grain: Grain, entry: Any, place: Any, active: Any) -> _Normals:
        t = self._types
        assert self._heights is not None
        scale = None if self._unscaled else self._scale(entry, active)
        gradient = self._heights.gradient(place, grain.uv, active)
        gradient = gradient if scale is None else gradient * scale
        dp_du, dp_dv = si.to_local(grain.dp_du), si.to_local(grain.dp_dv)
        along_u, along_v = tangent_slopes(dp_du, dp_dv)
        n = slope_normal(along_u * gradient.x + along_v * gradient.y)
        # Mitsuba takes the world's dp_du for one in the shading frame; only anisotropic materials show it.
        found = _Normals(n * dr.mulsign(t.Float(1), dr.dot(si.to_local(si.n), n)), si.dp_du)
        if self._moments is not None and si.footprint is not None:
            axes = (along_u, along_v) if scale is None else (along_u * scale, along_v * scale)
            found.slopes, found.share = self._moments.bumps(self._heights, place, si, axes, active)
        return found

    def _normal_mapped(self, si: Any, grain: Grain, place: Any, active: Any) -> _Normals:
        t = self._types
        assert self._normals is not None
        n, s = _unit(self._normals.eval(place, grain.uv, None, active) * 2 - 1), t.Array3f(1, 0, 0)
        found = _Normals(n, s) if si.grain is None else _Normals(_twisted(n, si, grain), _twisted(s, si, grain))
        if self._moments is not None and si.footprint is not None:
            found.slopes, found.share = self._moments.normals(place, si, active)
        return found

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


def _mixed(n: Any, other: Any, share: Any) -> Any:
    """The unit normal ``n``, replaced by ``other`` to a ``share``."""
    mixed = dr.fma(other - n, share, n)
    length2 = dr.squared_norm(mixed)
    usable = length2 > 0
    return dr.select(usable, mixed * dr.rsqrt(dr.select(usable, length2, 1)), other)


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
