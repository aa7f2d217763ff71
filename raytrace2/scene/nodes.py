"""The parsed, not yet interpreted scene: a graph of plain Python nodes, each knowing where it was written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np

from ..errors import Location


@dataclass(frozen=True)
class Color:
    """A colour given as linear RGB."""

    value: tuple[float, float, float]


@dataclass(frozen=True)
class SpectrumSamples:
    """A spectrum given as values at ``wavelengths`` (nm), or as one value for all when ``wavelengths`` is empty."""

    wavelengths: tuple[float, ...]
    values: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class LiveObject:
    """A Python object that was put into a scene dict as it is: a ``mi.Mesh``, a ``mi.Bitmap``, a tensor."""

    value: Any


@dataclass(frozen=True, eq=False)
class DistortedTransform:
    """A transform whose inverse, as Mitsuba keeps it, is not that of its matrix: a ``<rotate>`` about an axis that is
    not of unit length. Mitsuba neither makes the axis unit nor notices, and gets normals and inverses wrong."""


# float, int, bool, str; (3,) arrays for points and vectors; (4, 4) arrays for transforms
Value: TypeAlias = float | int | bool | str | np.ndarray | Color | SpectrumSamples | LiveObject | DistortedTransform


@dataclass(eq=False)
class Node:
    """One plugin of the scene. ``kind`` is its tag (``"shape"``, ``"bsdf"``, ...); ``children`` are in their order.
    ``id`` is of no other; ``name`` is what was written, or else ``id``."""

    kind: str
    plugin: str
    id: str
    location: Location
    properties: dict[str, Value] = field(default_factory=dict)
    children: list[tuple[str, Node]] = field(default_factory=list)
    name: str = ""


@dataclass(frozen=True, eq=False)
class ParsedScene:
    """``resolve`` finds a file as Mitsuba would; ``is_plugin`` tells whether Mitsuba has a plugin of that name."""

    root: Node
    resolve: Callable[[str], str]
    is_plugin: Callable[[str], bool]
    source: str | None
    settings: dict[str, str]
