"""From surfaces to a structure over them, by name."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from ..arguments import shortened, shown
from ..errors import SettingError
from ..surfaces.geometry import Geometry
from ..surfaces.primitives import Intersection
from ..surfaces.scan import Scan
from ..surfaces.structure import Structure
from ..surfaces.surface import Surface
from ..types import types
from .bounding_volumes import BoundingVolumes, BoundingVolumesConfig
from .bsp import Bsp, BspConfig
from .bvh import Bvh, BvhConfig
from .grid import Grid, GridConfig
from .hierarchical_grid import HierarchicalGrid, HierarchicalGridConfig
from .kdtree import KdTreeConfig, KdTreeStructure


def _brute_force(geometry: Geometry, **options: Any) -> Structure:
    if options:
        raise TypeError(f"brute_force takes no options, not {sorted(options)}")
    return Scan(geometry)


def _bounding_volumes(geometry: Geometry, **options: Any) -> Structure:
    return BoundingVolumes(geometry, BoundingVolumesConfig(**options))


def _bvh(geometry: Geometry, **options: Any) -> Structure:
    return Bvh(geometry, BvhConfig(**options))


def _grid(geometry: Geometry, **options: Any) -> Structure:
    return Grid(geometry, GridConfig(**options))


def _hierarchical_grid(geometry: Geometry, **options: Any) -> Structure:
    return HierarchicalGrid(geometry, HierarchicalGridConfig(**options))


def _bsp(geometry: Geometry, **options: Any) -> Structure:
    return Bsp(geometry, BspConfig(**options))


def _kdtree(geometry: Geometry, **options: Any) -> Structure:
    return KdTreeStructure(geometry, KdTreeConfig(**options))


_KINDS: dict[str, Callable[..., Structure]] = {
    "brute_force": _brute_force,
    "bounding_volumes": _bounding_volumes,
    "bvh": _bvh,
    "grid": _grid,
    "hierarchical_grid": _hierarchical_grid,
    "kdtree": _kdtree,
    "bsp": _bsp,
}


def names() -> tuple[str, ...]:
    """Every kind that :func:`build` takes."""
    return tuple(_KINDS)


def build(
    surfaces: Surface | Sequence[Surface],
    kind: str = "bvh",
    *,
    precision: str = "float32",
    intersection: Intersection = "watertight",
    **options: Any,
) -> Structure:
    """A structure of ``kind`` over a Surface or a list of them, structures included: it is a Surface itself.

    ``kind`` may carry options after a colon, as on the command line: ``"bvh:max_leaf_size=2"``. ``options`` are the
    fields of the kind's config. :class:`~raytrace2.SettingError` (a ``ValueError``) tells of kinds, options and values
    that do not exist.

    ``intersection="watertight"``: no ray slips between triangles that share an edge or a vertex, and all structures
    give the same bits. ``"fast"``, which may also stand after the colon, takes a quicker test of triangles and, in a
    bvh of boxes, no margin for rounding: it agrees to rounding on most rays, but a ray that passes within rounding of
    an edge may slip through or meet either side, and structures may differ in that. Structures among ``surfaces`` keep
    their own.
    """
    name, written = parse_kind(kind)
    given: Any = surfaces
    if isinstance(given, Surface):
        items: list[Surface] = [given]
    elif isinstance(given, Iterable) and not isinstance(given, str | bytes):
        items = list(given)
    else:
        raise TypeError(f"build takes a Surface or a list of them, not {type(given).__name__}")
    for item in items:
        if not isinstance(item, Surface):
            raise TypeError(f"build takes Surfaces, not {type(item).__name__}")
    geometry = Geometry(items, types(precision), intersection=written.pop("intersection", intersection))
    try:
        return _KINDS[name](geometry, **{**written, **options})
    except (TypeError, ValueError) as error:
        raise SettingError(f"{name}: {_plainly(error)}") from error


def parse_kind(text: str) -> tuple[str, dict[str, Any]]:
    """``"bvh:max_leaf_size=2,node_cost=1.5"`` as a name and options; numbers become numbers."""
    if not isinstance(text, str):
        raise SettingError(f"an acceleration structure is named by a string, not {shown(text)}")
    name, _, rest = text.partition(":")
    if name not in _KINDS:
        raise SettingError(f"unknown acceleration structure {shown(name)}; there are {', '.join(_KINDS)}")
    options: dict[str, Any] = {}
    for item in filter(None, rest.split(",")):
        key, equals, value = item.partition("=")
        if not equals:
            raise SettingError(f"{shown(item)} in {shown(text)} should read option=value")
        options[key.strip()] = _number(value.strip())
    return name, options


def _plainly(error: Exception) -> str:
    """What a config says of an option that it does not have, in the user's words."""
    found = re.search(r"unexpected keyword argument '(\w+)'", str(error))
    return shortened(f"there is no option {found[1]!r}" if found else str(error), 500)


def _number(text: str) -> Any:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
