"""Who filters: the film's samples, or the texture look-up of one sample that stands for a pixel."""

from __future__ import annotations

from dataclasses import dataclass, replace

from .errors import SettingError
from .rays.differentials import check_differentials
from .scene.description import Film, ReconstructionFilter
from .textures.filter_settings import FilterSettings, parse_filter

_BOX = ReconstructionFilter("box")


@dataclass(frozen=True)
class Filtering:
    """``textures``: the filter of every bitmap, or None for each its own. ``differentials``: how rays know their
    footprints. ``centred``: samples lie in the middle of pixels. ``film``: the film, with the pixel filter that is left
    to it."""

    textures: FilterSettings | None
    differentials: str
    centred: bool
    film: Film


def plan_filtering(
    filter: str | FilterSettings | None, differentials: str | None, film: Film, sample_count: int
) -> Filtering:
    """What ``filter`` and ``differentials`` mean for ``sample_count`` samples a pixel.

    A filter that heeds footprints does the pixel filter's work where there is one sample a pixel: the sample lies in
    the middle, the look-up integrates over the film's own pixel filter and the sample counts for its pixel alone.
    More samples lie where the sampler puts them and share the pixel: each look-up covers the part that is the sample's,
    as a box, and the film does the rest. Without ``differentials`` such filters take ``autodiff``
    (``mip_distance``: ``distance``), and others ``none``.
    """
    settings = None if filter is None else parse_filter(filter)
    heeds = settings is not None and settings.needs_footprint
    if differentials is None:
        by_distance = settings is not None and settings.name == "mip_distance"
        differentials = ("distance" if by_distance else "autodiff") if heeds else "none"
    check_differentials(differentials)
    if heeds and differentials == "none":
        assert settings is not None
        raise SettingError(f"filter {settings.name!r} needs footprints: choose differentials other than 'none'")
    if settings is None or not heeds or sample_count > 1:
        return Filtering(settings, differentials, False, film)
    return Filtering(replace(settings, pixel=film.rfilter), differentials, True, replace(film, rfilter=_BOX))
