"""Arbitrary output variables: what is at the first hit of each ray, a channel each."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr

from ..errors import SettingError
from ..rays.differentials import NO_DIFFERENTIALS, Bouncing, uv_partials
from ..rays.ray import Ray
from ..scene.description import Integrator
from ..scene.traced import TracedScene
from ..surfaces.hit import Counts
from ..surfaces.interaction import SurfaceInteraction
from .tracing import Tracing

_AXES = ("X", "Y", "Z")
_COLORS = ("R", "G", "B")
_UV = ("U", "V")
#: The kinds of ``aovs`` and the channel suffixes of each, as Mitsuba names them; those of ``accel.`` are our own, and
#: tell how many volumes, nodes and primitives of the structure each ray met on its way, misses included. So is
#: ``footprint_flags``: the sum of the bits of :mod:`~raytrace2.rays.differentials.trust`, 0 without differentials.
CHANNELS: dict[str, tuple[str, ...]] = {
    "albedo": _COLORS,
    "depth": ("T",),
    "position": _AXES,
    "uv": _UV,
    "geo_normal": _AXES,
    "sh_normal": _AXES,
    "dp_du": _AXES,
    "dp_dv": _AXES,
    "duv_dx": _UV,
    "duv_dy": _UV,
    "footprint_flags": ("N",),
    "prim_index": ("I",),
    "shape_index": ("I",),
    "accel.volumes": ("N",),
    "accel.nodes": ("N",),
    "accel.primitives": ("N",),
}

#: Those that count, whose derivatives are zero.
COUNTED = tuple(kind for kind, suffixes in CHANNELS.items() if suffixes in (("N",), ("I",)))
#: Those that tell of footprints.
FOOTPRINTS = ("duv_dx", "duv_dy")


def parse_aovs(text: str) -> tuple[tuple[str, str], ...]:
    """The (name, kind) pairs of ``"depth,n:sh_normal"``: kinds, with names where these are others."""
    tokens = text.replace(",", " ").split()
    return tuple((name, kind if colon else name) for name, colon, kind in (token.partition(":") for token in tokens))


def check_aovs(aovs: tuple[tuple[str, str], ...]) -> None:
    """``SettingError`` if there are none, for what is no kind, and where channels would have no names, or the same
    ones."""
    unknown = [kind for _, kind in aovs if kind not in CHANNELS]
    if unknown or not aovs:
        wrong = f"there is no aov {unknown[0]!r}" if unknown else "no aovs are listed"
        raise SettingError(f"{wrong}; kinds are: {', '.join(CHANNELS)}")
    channels = [f"{name}.{suffix}" for name, kind in aovs for suffix in CHANNELS[kind]]
    if not all(name for name, _ in aovs) or len(set(channels)) < len(channels):
        found = ",".join(map(":".join, aovs))
        raise SettingError(f"aovs need names that differ, such as a:depth,b:depth; not {found}")


def channel_names(settings: Integrator) -> list[str]:
    """The names of the channels of ``settings.aovs``, in order."""
    return [f"{name}.{suffix}" for name, kind in settings.aovs for suffix in CHANNELS[kind]]


def aov(
    scene: TracedScene,
    settings: Integrator,
    ray: Ray,
    offset_rays: tuple[Ray, Ray] | None,
    active: Any = True,
    *,
    differentials: Bouncing = NO_DIFFERENTIALS,
    differential: Any = None,
    tracing: Tracing | None = None,
    random: Any = None,
) -> list[Any]:
    """The values (Float) of every channel of ``settings.aovs`` along each ray, zero on a miss.

    ``duv_dx`` and ``duv_dy`` are what ``differentials`` say, and else found with ``offset_rays``, a pixel to the right
    and a pixel down. A ``tracing`` other than the scene's own does not count what rays cost.
    ``random`` (Array2f) is for filters that read texels at random.
    """
    counts: Counts | None = None
    if tracing is not None:
        hit = tracing.closest(ray, active, None)
    elif any(kind.startswith("accel.") for _, kind in settings.aovs):
        hit, counts = scene.structure.count(ray, active)
    else:
        hit = scene.structure.intersect(ray, active)
    meeting = differentials.meet(scene.structure, ray, differential, hit)
    si = (meeting if random is None else meeting.drawing(random)).si
    Float = scene.types.Float
    values: list[Any] = []
    for _, kind in settings.aovs:
        if kind.startswith("accel."):
            values.append(dr.select(active, Float(getattr(counts, kind.removeprefix("accel."))), 0))
        else:
            found = _value(kind, scene, ray, si, offset_rays)
            values.extend(dr.select(si.valid & active, Float(value), 0) for value in found)
    return values


def needs_offset_rays(settings: Integrator) -> bool:
    """Whether :func:`aov` needs ``offset_rays``."""
    return any(kind in FOOTPRINTS for _, kind in settings.aovs)


_FIELDS: dict[str, Callable[[SurfaceInteraction], Any]] = {
    "position": lambda si: si.p,
    "uv": lambda si: si.uv,
    "geo_normal": lambda si: si.n,
    "sh_normal": lambda si: si.sh_frame.n,
    "dp_du": lambda si: si.dp_du,
    "dp_dv": lambda si: si.dp_dv,
}


def _value(
    kind: str, scene: TracedScene, ray: Ray, si: SurfaceInteraction, offset_rays: tuple[Ray, Ray] | None
) -> list[Any]:
    if kind == "sh_normal" and scene.has_reliefs:
        return list(scene.materials.shading_normal(si, scene.material(si, si.valid), si.valid))
    if kind in _FIELDS:
        return list(_FIELDS[kind](si))
    if kind == "depth":
        return [si.t]
    if kind == "prim_index":
        return [si.prim]
    if kind == "shape_index":
        return [scene.shape_index(si)]
    if kind == "albedo":
        return list(scene.materials.albedo(si, scene.material(si, si.valid), si.valid))
    if kind == "footprint_flags":
        return [0 if si.footprint is None else si.footprint.flags]
    if si.footprint is not None:
        return list(si.footprint.dx if kind == "duv_dx" else si.footprint.dy)
    assert offset_rays is not None
    return list(uv_partials(si, ray, offset_rays[0 if kind == "duv_dx" else 1]))
