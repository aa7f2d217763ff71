"""Every procedural scene by name."""

from __future__ import annotations

from collections.abc import Callable

from ...errors import SettingError
from .architecture import architecture
from .balls import balls, shells
from .bumpy import bumpy_sphere_scene
from .disorder import slivers, soup
from .frames import lattice, rings, tree
from .gears import gears
from .landscapes import mountain, terrain_scene
from .scene import ProceduralScene
from .teapot import stadium, teapot
from .tetra import tetra

_SCENES: dict[str, Callable[[int, int], ProceduralScene]] = {
    "architecture": architecture,
    "balls": balls,
    "bumpy_sphere": bumpy_sphere_scene,
    "gears": gears,
    "lattice": lattice,
    "mountain": mountain,
    "rings": rings,
    "shells": shells,
    "slivers": slivers,
    "soup": soup,
    "stadium": stadium,
    "teapot": teapot,
    "terrain": terrain_scene,
    "tetra": tetra,
    "tree": tree,
}

#: Fewer primitives than this show nothing of what a scene is about.
SMALLEST = 100


def names() -> tuple[str, ...]:
    """Every name that :func:`make` takes."""
    return tuple(_SCENES)


def make(name: str, size: int = 10_000, seed: int = 0) -> ProceduralScene:
    """The scene ``name`` of about ``size`` primitives: a sequence of Surfaces, with a ``view`` to look at them from.

    The same arguments give the same scene; scenes without chance are the same for every ``seed``. ``SettingError`` (a
    ``ValueError``) for an unknown name or fewer than 100 primitives.
    """
    if name not in _SCENES:
        raise SettingError(f"unknown scene {name!r}; there are {', '.join(_SCENES)}")
    if isinstance(size, bool) or not float(size).is_integer() or size < SMALLEST:
        raise SettingError(f"size must be a whole number from {SMALLEST} on, not {size!r}")
    return _SCENES[name](int(size), seed)
