"""Which texture filter, with its options and the pixel filter that it stands in for."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any

from ..errors import SettingError
from ..scene.description import ReconstructionFilter


@dataclass(frozen=True)
class FilterSettings:
    """``name`` is one of :func:`filter_names`. ``max_anisotropy`` bounds the ratio of a footprint's axes for the
    filters that walk along the longer one (0: no bound). ``pyramid`` is the kernel that halves images: ``"box"`` or
    ``"lanczos"``. ``of`` is the filter that ``stochastic`` samples. ``budget``: the texels that ``exact`` may read of
    a footprint before it goes to a coarser level.

    ``pixel`` is the pixel filter that the look-up shall apply: the film's, where one sample stands for a pixel.
    """

    name: str
    max_anisotropy: float = 16.0
    pyramid: str = "box"
    of: str = "ewa"
    budget: int = 180
    pixel: ReconstructionFilter = field(default=ReconstructionFilter("box"))

    @property
    def needs_footprint(self) -> bool:
        """Whether look-ups heed a footprint at all."""
        return self.name not in POINT_FILTERS

    @property
    def needs_pyramid(self) -> bool:
        """Whether look-ups read coarser levels of images."""
        return (self.of if self.name == "stochastic" else self.name) in PYRAMID_FILTERS

    @property
    def needs_blocks(self) -> bool:
        """Whether look-ups read blocks of texels with their slopes."""
        return self.name in EXACT_FILTERS

    def __post_init__(self) -> None:
        if self.name not in filter_names():
            raise SettingError(f"unknown filter {self.name!r}; there are {', '.join(filter_names())}")
        if self.max_anisotropy != 0 and not self.max_anisotropy >= 1:
            raise SettingError(f"{self.name}: max_anisotropy must be 1 or more, or 0 for no bound")
        if self.pyramid not in ("box", "lanczos"):
            raise SettingError(f"{self.name}: pyramid must be 'box' or 'lanczos', not {self.pyramid!r}")
        if self.of not in filter_names() or self.of == "stochastic":
            raise SettingError(f"{self.name}: of must be another filter, not {self.of!r}")
        if not (isinstance(self.budget, int) and self.budget >= 4):
            raise SettingError(f"{self.name}: budget must be a whole number of texels, 4 or more")
        exact = (self.of if self.name == "stochastic" else self.name) in EXACT_FILTERS
        if exact and self.pixel.name not in EXACT_PIXEL_FILTERS:
            raise SettingError(
                f"{self.name} integrates the pixel filters {', '.join(EXACT_PIXEL_FILTERS)}, not {self.pixel.name!r}; "
                "choose one of them or another texture filter"
            )


#: Filters that read the texels around a point, whatever the footprint.
POINT_FILTERS = ("nearest", "bilinear", "bicubic")
FOOTPRINT_FILTERS = ("mip_distance", "trilinear", "trilinear_shorter", "ewa", "probes", "exact", "exact2", "stochastic")
#: Of these the ones that read images at half, a quarter, ... of their size.
PYRAMID_FILTERS = ("mip_distance", "trilinear", "trilinear_shorter", "ewa", "probes")
#: And those that read blocks of texels with their slopes.
EXACT_FILTERS = ("exact", "exact2")
#: Pixel filters that those integrate.
EXACT_PIXEL_FILTERS = ("box", "tent", "gaussian")


def filter_names() -> tuple[str, ...]:
    """Every texture filter."""
    return (*POINT_FILTERS, *FOOTPRINT_FILTERS)


def parse_filter(text: str | FilterSettings) -> FilterSettings:
    """``"ewa:max_anisotropy=8"`` as settings; ``SettingError`` for names, options and values that do not exist."""
    if isinstance(text, FilterSettings):
        return text
    name, _, rest = text.partition(":")
    options: dict[str, Any] = {}
    known = {f.name: f for f in fields(FilterSettings) if f.name not in ("name", "pixel")}
    for item in filter(None, rest.split(",")):
        key, equals, value = (part.strip() for part in item.partition("="))
        if not equals or key not in known:
            raise SettingError(f"{name}: {item!r} is no option; there are {', '.join(known)}, given as option=value")
        kind: Any = type(known[key].default)
        try:
            options[key] = kind(value)
        except ValueError:
            raise SettingError(f"{name}: {key} must be a number, not {value!r}") from None
    return replace(FilterSettings(name), **options)


__all__ = ["FOOTPRINT_FILTERS", "POINT_FILTERS", "PYRAMID_FILTERS", "FilterSettings", "filter_names", "parse_filter"]
