"""All materials of a scene, met by index inside kernels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import drjit as dr

from ..live import Slot
from ..rays.footprint import shared
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
from .relief import Relief, reliefs
from .relief_frames import ReliefFrame, ReliefFrames, Reliefs
from .rough_conductor import RoughConductor, polished
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

    Leaf materials are in one table a kind; two-sided ones, masks, bump and normal maps are resolved to leaves, with the
    frames that maps give them (and, under a filter that heeds footprints, how normals spread). Kernels hold the kinds
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
        self._polished: dict[int, RoughConductorBsdf] = {}
        maps = [reliefs(b) for b in bsdfs]
        widening = textures.settings is not None and textures.settings.needs_footprint
        both = [sides(b) for b in bsdfs]
        if widening:
            both = [tuple(map(self._widenable, *x)) for x in zip(both, maps, strict=True)]  # type: ignore[misc]
        pairs = [tuple(None if leaf is None else _enlist(leaf, leaves, known) for leaf in pair) for pair in both]
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

    def slots(self) -> list[Slot]:
        """Those of live numbers; of live textures, their table's."""
        found: list[Slot] = []
        for leaf in self._leaves.values():
            if isinstance(leaf, Dielectric | ThinDielectric):
                found += leaf.slots()
        return found + (self._reliefs.slots() if self._reliefs else [])

    def index_of(self, bsdf: Bsdf) -> int:
        """The index of ``bsdf``, one of those given to :meth:`build` (by identity); ``ValueError`` if it is not."""
        for index, known in zip(self.indices, self._keep, strict=True):
            if known is bsdf:
                return index
        raise ValueError("this material is not in the table")

    def sample(self, si: Any, material: Any, sample1: Any, sample2: Any, active: Any = True) -> BsdfSample:
        """A direction for ``si.wi``: ``sample1`` (Float) chooses the lobe, ``sample2`` (Array2f) the direction."""
        active = self.types.Bool(active)
        side = self._meet(si, material, active)
        opacity = solid = None
        reached = active
        if self._masks:
            opacity = self._masks.opacity(material, si, active)
            solid = sample1 < opacity
            sample1 = sample1 / dr.detach(dr.select(solid, opacity, 1))
            reached = active & solid
        maps = self._maps(si, material, side, active)
        result: Any = None
        for leaf, place, chosen, here in self._dispatch(si, side.leaf, reached):
            if maps is None:
                one = leaf.sample(si, side.wi, place, sample1, sample2, here)
            else:
                one = _sample_mapped(maps.of(leaf), leaf, si, side.wi, place, sample1, sample2, here)
            result = one if result is None else _select(chosen, one, result)
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
        side = self._meet(si, material, active)
        maps = self._maps(si, material, side, active)
        wo = side.turn(wo)
        for leaf, place, _, here in self._dispatch(si, side.leaf, active):
            if leaf.smooth:
                if maps is None:
                    one = leaf.eval_pdf(si, side.wi, wo, place, here)
                else:
                    one = _eval_mapped(maps.of(leaf), leaf, si, side.wi, wo, place, here)
                value = dr.select(here, one[0], value)
                pdf = dr.select(here, one[1], pdf)
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
        side = self._meet(si, material, active)
        for leaf, place, _, here in self._dispatch(si, side.leaf, active):
            if leaf.smooth:
                result = dr.select(here, leaf.albedo(si, place, here), result)
        return result

    @property
    def has_reliefs(self) -> bool:
        """Whether any material has a bump or normal map."""
        return self._reliefs is not None

    def shading_normal(self, si: Any, material: Any, active: Any = True) -> Any:
        """The normal (Array3f, world coordinates) that shading works with: the map's, where there is one."""
        side = self._meet(si, material, self.types.Bool(active))
        maps = self._maps(si, material, side, self.types.Bool(active))
        if maps is None:
            return si.sh_frame.n
        relief = maps.widened or maps.drawn
        assert relief is not None
        n = side.turn(relief.to_world(type(si.wi)(0, 0, 1)))
        return si.to_world(n if side.flipped is None else dr.select(side.flipped, -n, n))

    def _widenable(self, leaf: Bsdf | None, relief: Relief | None) -> Bsdf | None:
        """``leaf``, or for a smooth conductor under a map one that is rough where normals spread."""
        if relief is None or not isinstance(leaf, ConductorBsdf):
            return leaf
        return self._polished.setdefault(id(leaf), polished(leaf))

    def _maps(self, si: Any, material: Any, side: Side, active: Any) -> Reliefs | None:
        """The frames of the maps on a side; None where no material has one."""
        if self._reliefs is None or self._sides is None:
            return None
        entry = self._sides.entry(self.types.UInt(material), side.flipped)
        kinds = self._leaves.values()
        widens, draws = any(k.widens for k in kinds), any(not k.widens for k in kinds)
        return self._reliefs.at(si, side.wi, entry, active, widens=widens, draws=draws)

    def _meet(self, si: Any, material: Any, active: Any) -> Side:
        material = self.types.UInt(material)
        if self._sides is None:
            return Side(material, si.wi, None)
        side = self._sides.meet(material, si.wi, active)
        # Its ``wi`` may carry derivatives, where that of who asks next does not.
        side.leaf, side.flipped = shared(si, (id(self), "side", material, active), lambda: (side.leaf, side.flipped))
        return side

    def _dispatch(self, si: Any, leaf: Any, active: Any) -> Iterator[tuple[Any, Any, Any, Any]]:
        """(table of a kind, place in it, lanes that are of it, those of them that are active), for each kind."""
        single = len(self._leaves) == 1

        def lanes() -> list[tuple[Any, Any, Any]]:
            place, chosen = handles.place_of(leaf), [handles.kind_of(leaf) == kind for kind in self._leaves]
            return [(place, None, active) if single else (place, c, active & c) for c in chosen]

        found = shared(si, (id(self), "lanes", leaf, active), lanes)
        for table, (place, chosen, here) in zip(self._leaves.values(), found, strict=True):
            yield table, place, chosen, here

    def _leaf(self, handle: int) -> Any:
        return self._leaves[handles.kind_of(handle)]


def _sample_mapped(
    relief: ReliefFrame, leaf: Any, si: Any, wi: Any, place: Any, sample1: Any, sample2: Any, active: Any
) -> BsdfSample:
    """What ``leaf`` samples in the frame of a map, taken to that of the surface."""
    more = {} if relief.spread is None else {"spread": relief.spread}
    one: BsdfSample = leaf.sample(si, relief.to_local(wi), place, sample1, sample2, active, **more)
    wo = relief.to_world(one.wo)
    left = relief.transmitted(one.wo, wo)
    one.weight, one.pdf, one.wo = one.weight * left, dr.select(left > 0, one.pdf, 0), wo
    return one


def _eval_mapped(relief: ReliefFrame, leaf: Any, si: Any, wi: Any, wo: Any, place: Any, active: Any) -> tuple[Any, Any]:
    """Value and density of ``leaf`` in the frame of a map."""
    more = {} if relief.spread is None else {"spread": relief.spread}
    inner = relief.to_local(wo)
    value, pdf = leaf.eval_pdf(si, relief.to_local(wi), inner, place, active, **more)
    left = relief.transmitted(inner, wo)
    return value * left, dr.select(left > 0, pdf, 0)


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
