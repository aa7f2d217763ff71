"""All materials of a scene, met by index inside kernels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import drjit as dr

from ..scene.description import (
    Bsdf,
    ConductorBsdf,
    DielectricBsdf,
    DiffuseBsdf,
    RoughConductorBsdf,
    ThinDielectricBsdf,
)
from ..textures import TextureTable
from ..textures import handle as handles
from ..types import Types
from .conductor import Conductor
from .dielectric import Dielectric
from .diffuse import Diffuse
from .mask import Masks, opacities
from .relief import reliefs
from .relief_frames import ReliefFrame, ReliefFrames
from .rough_conductor import RoughConductor
from .sample import BsdfSample
from .thin_dielectric import ThinDielectric
from .twosided import Side, Sides, sides

_KINDS: dict[type, Any] = {
    DiffuseBsdf: Diffuse,
    ConductorBsdf: Conductor,
    DielectricBsdf: Dielectric,
    ThinDielectricBsdf: ThinDielectric,
    RoughConductorBsdf: RoughConductor,
}
_ORDER = list(_KINDS)


class MaterialTable:
    """Materials by index: ``indices[i]`` (a handle, not a position) is that of the ``i``-th one given to :meth:`build`.

    Leaf materials are in one table a kind; two-sided ones and masks are resolved to leaves. Kernels hold the kinds
    that occur, and no dispatch where there is one. Python flags tell integrators what they can leave out:
    ``has_smooth_any`` (lobes that are not deltas), ``has_delta`` (mirror-like and null lobes), ``has_null``
    (straight on: masks, thin dielectrics), ``has_transmission`` (anything that crosses the surface),
    ``has_refraction`` (an ``eta`` other than 1). Directions are in the shading frame and point away from the
    surface. What inactive lanes get means nothing.
    """

    def __init__(self, bsdfs: Sequence[Bsdf], textures: TextureTable) -> None:
        self.types = textures.types
        self.textures = textures
        leaves: dict[int, list[Bsdf]] = {}
        known: dict[int, int] = {}
        self._keep = list(bsdfs)
        pairs = [tuple(None if leaf is None else _enlist(leaf, leaves, known) for leaf in sides(b)) for b in bsdfs]
        chains = [opacities(b) for b in bsdfs]
        _check(bsdfs)
        self._leaves = {kind: _KINDS[_ORDER[kind]](leaves[kind], textures) for kind in sorted(leaves)}
        kinds = self._leaves.values()
        self.has_null = any(chains) or any(isinstance(k, ThinDielectric) for k in kinds)
        self.has_smooth_any = any(k.smooth for k in kinds)
        self.has_delta = self.has_null or any(k.delta for k in kinds)
        self.has_transmission = self.has_null or any(k.transmission for k in kinds)
        self.has_refraction = any(isinstance(k, Dielectric) for k in kinds)
        self._all_smooth = all(k.smooth for k in kinds)
        self._masks = Masks(chains, textures) if any(chains) else None
        maps = [reliefs(b) for b in bsdfs]
        if self._masks or any(back is not None for _, back in pairs) or any(any(pair) for pair in maps):
            smooth = [any(h is not None and self._leaf(h).smooth for h in pair) for pair in pairs]
            self._sides: Sides | None = Sides(pairs, smooth, self.types)  # type: ignore[arg-type]
            self.indices = tuple(range(len(bsdfs)))
        else:
            self._sides = None
            self.indices = tuple(front for front, _ in pairs)  # type: ignore[misc]
        self._reliefs: ReliefFrames | None = None
        if self._sides and any(any(pair) for pair in maps):
            entries = [m for pair in maps for m in (pair if self._sides.any_two_sided else pair[:1])]
            self._reliefs = ReliefFrames(entries, textures)
        textures.finish()

    @staticmethod
    def build(bsdfs: Sequence[Bsdf], types: Types, textures: TextureTable | None = None) -> MaterialTable:
        """A table of ``bsdfs``, whose textures join ``textures`` (or a table of their own).

        ``ValueError`` for what cannot be: a transmissive material inside a two-sided one, an index of refraction that
        is not positive, no material at all.
        """
        if not bsdfs:
            raise ValueError("a material table needs at least one material")
        return MaterialTable(bsdfs, textures if textures is not None else TextureTable(types))

    def index_of(self, bsdf: Bsdf) -> int:
        """The index of ``bsdf``, one of those given to :meth:`build` (by identity); ``ValueError`` if it is not."""
        for index, known in zip(self.indices, self._keep, strict=True):
            if known is bsdf:
                return index
        raise ValueError("this material is not in the table")

    def sample(self, si: Any, material: Any, sample1: Any, sample2: Any, active: Any = True) -> BsdfSample:
        """A direction for ``si.wi``: ``sample1`` (Float) chooses the lobe, ``sample2`` (Array2f) the direction."""
        active = self.types.Bool(active)
        side = self._meet(material, si.wi, active)
        opacity = solid = None
        reached = active
        if self._masks:
            opacity = self._masks.opacity(material, si, active)
            solid = sample1 < opacity
            sample1 = sample1 / dr.select(solid, opacity, 1)
            reached = active & solid
        relief, wi = self._relief(si, material, side, active)
        result: Any = None
        for leaf, chosen, here in self._dispatch(side.leaf, reached):
            one = leaf.sample(si, wi, handles.place_of(side.leaf), sample1, sample2, here)
            result = one if result is None else _select(chosen, one, result)
        if relief:
            wo = relief.to_world(result.wo)
            passes = relief.passes(result.wo, wo)
            result.weight = dr.select(passes, result.weight * relief.shadowing(wo), 0)
            result.pdf = dr.select(passes, result.pdf, 0)
            result.wo = wo
        result.wo = side.turn(result.wo)
        return self._masks.through(si.wi, opacity, solid, result) if self._masks else result

    def eval_pdf(self, si: Any, material: Any, wo: Any, active: Any = True) -> tuple[Any, Any]:
        """Value times cosine (Array3f) and density per steradian (Float) for ``wo``; delta lobes do not count.

        Called beside :meth:`sample` with the same ``si``, ``material`` and ``active``, it shares its texture look-ups.
        """
        t = self.types
        value, pdf = dr.zeros(t.Array3f), dr.zeros(t.Float)
        if not self.has_smooth_any:
            return value, pdf
        active = t.Bool(active)
        side = self._meet(material, si.wi, active)
        relief, wi = self._relief(si, material, side, active)
        outer = side.turn(wo)
        wo = relief.to_local(outer) if relief else outer
        for leaf, _, here in self._dispatch(side.leaf, active):
            if leaf.smooth:
                one = leaf.eval_pdf(si, wi, wo, handles.place_of(side.leaf), here)
                value = dr.select(here, one[0], value)
                pdf = dr.select(here, one[1], pdf)
        if relief:
            passes = relief.passes(wo, outer)
            value, pdf = dr.select(passes, value * relief.shadowing(outer), 0), dr.select(passes, pdf, 0)
        if self._masks:
            opacity = self._masks.opacity(material, si, active)
            return value * opacity, pdf * opacity
        return value, pdf

    def has_smooth(self, material: Any, active: Any = True) -> Any:
        """Whether ``material`` has a lobe that is not a delta (Bool): whether sampling of lights makes sense."""
        t = self.types
        if self._all_smooth or not self.has_smooth_any:
            return t.Bool(self._all_smooth)
        if self._sides:
            return self._sides.has_smooth(material, t.Bool(active))
        result = t.Bool(False)
        for kind, leaf in self._leaves.items():
            if leaf.smooth:
                result = result | (handles.kind_of(material) == kind)
        return result

    def albedo(self, si: Any, material: Any, active: Any = True) -> Any:
        """The diffuse reflectance (Array3f) of Mitsuba's albedo AOV: black where all is specular, masks ignored."""
        t = self.types
        active = t.Bool(active)
        result = dr.zeros(t.Array3f)
        if not self.has_smooth_any:
            return result
        side = self._meet(material, si.wi, active)
        for leaf, _, here in self._dispatch(side.leaf, active):
            if leaf.smooth:
                result = dr.select(here, leaf.albedo(si, handles.place_of(side.leaf), here), result)
        return result

    @property
    def has_reliefs(self) -> bool:
        """Whether any material has a bump or normal map."""
        return self._reliefs is not None

    def shading_normal(self, si: Any, material: Any, active: Any = True) -> Any:
        """The normal (Array3f, world coordinates) that shading works with: the map's, where there is one."""
        side = self._meet(material, si.wi, self.types.Bool(active))
        relief, _ = self._relief(si, material, side, self.types.Bool(active))
        if relief is None:
            return si.sh_frame.n
        n = side.turn(relief.to_world(type(si.wi)(0, 0, 1)))
        return si.to_world(n if side.flipped is None else dr.select(side.flipped, -n, n))

    def _relief(self, si: Any, material: Any, side: Side, active: Any) -> tuple[ReliefFrame | None, Any]:
        """The frame of the map on a side (None where no material has one), and ``side.wi`` seen from it."""
        if self._reliefs is None or self._sides is None:
            return None, side.wi
        relief = self._reliefs.at(si, side.wi, self._sides.entry(self.types.UInt(material), side.flipped), active)
        return relief, relief.to_local(side.wi)

    def _meet(self, material: Any, wi: Any, active: Any) -> Side:
        material = self.types.UInt(material)
        return self._sides.meet(material, wi, active) if self._sides else Side(material, wi, None)

    def _dispatch(self, leaf: Any, active: Any) -> Iterator[tuple[Any, Any, Any]]:
        """(table of a kind, lanes that are of it, those of them that are active), for each kind."""
        for kind, table in self._leaves.items():
            if len(self._leaves) == 1:
                yield table, None, active
            else:
                chosen = handles.kind_of(leaf) == kind
                yield table, chosen, active & chosen

    def _leaf(self, handle: int) -> Any:
        return self._leaves[handles.kind_of(handle)]


def _select(mask: Any, a: BsdfSample, b: BsdfSample) -> BsdfSample:
    return BsdfSample(
        dr.select(mask, a.wo, b.wo),
        dr.select(mask, a.weight, b.weight),
        dr.select(mask, a.pdf, b.pdf),
        dr.select(mask, a.eta, b.eta),
        dr.select(mask, a.delta, b.delta),
        dr.select(mask, a.null, b.null),
    )


def _enlist(leaf: Bsdf, leaves: dict[int, list[Bsdf]], known: dict[int, int]) -> int:
    if id(leaf) not in known:
        if type(leaf) not in _KINDS:
            raise TypeError(f"{type(leaf).__name__} is no material")
        kind = _ORDER.index(type(leaf))
        members = leaves.setdefault(kind, [])
        known[id(leaf)] = handles.make(kind, len(members))
        members.append(leaf)
    return known[id(leaf)]


def _check(bsdfs: Sequence[Bsdf]) -> None:
    for b in bsdfs:
        front, back = sides(b)
        for side in (front, back):
            if back is not None and side is not None and _KINDS[type(side)].transmission:
                raise ValueError("a twosided material cannot hold a transmissive one; use it without twosided")
