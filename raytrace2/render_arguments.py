"""What users ask of a render, checked before anything is built: types, ranges, and sizes that this machine can hold."""

from __future__ import annotations

import os
from typing import Any

import drjit as dr

from .arguments import shown, whole_number
from .errors import SettingError
from .scene.description import Film, Integrator
from .scene.scene import Scene
from .types import types

_SIDES = ("width", "height")
_LARGEST_SIDE = 1 << 20
_MOST_SAMPLES = 2**31 - 1
#: A pass is at least a kernel launch: a million of them are hours, and many more come from a slip of the pen.
_MOST_PASSES = 1 << 20


def check_scene(scene: Any) -> None:
    """``TypeError`` unless ``scene`` is what ``rt.load_file`` gives."""
    if not isinstance(scene, Scene):
        raise TypeError(f"render takes a Scene, as rt.load_file gives it, not {shown(scene)}")


def checked_counts(spp: Any, seed: Any) -> tuple[int, Any]:
    """Samples a pixel as an int, and the seed, an int or a UInt of Dr.Jit; ``SettingError`` for other things and for
    counts out of range."""
    spp = whole_number(spp, "spp (0: the scene's own)", least=0, most=_MOST_SAMPLES)
    if not isinstance(seed, dr.ArrayBase):
        return spp, whole_number(seed, "seed")
    if not dr.is_integral_v(seed) or dr.depth_v(seed) != 1 or dr.width(seed) != 1:
        raise SettingError(f"seed must be one whole number, not {dr.width(seed)} {type(seed).__name__}")
    return spp, types("float32").UInt(seed)


def checked_visibility(samples: Any) -> bool | int:
    """False, True, or a number of samples; ``SettingError`` for anything else."""
    if isinstance(samples, bool):
        return samples
    return whole_number(samples, "visibility_gradients (or True, or False)", least=0, most=_MOST_SAMPLES)


def checked_size(size: Any) -> tuple[int, int]:
    """Width and height as ints; ``SettingError`` for anything but two whole numbers in range."""
    if not isinstance(size, tuple | list) or len(size) != 2:
        raise SettingError(f"size must be (width, height), not {shown(size)}")
    width, height = (whole_number(side, f"the film's {name}") for side, name in zip(size, _SIDES, strict=True))
    if not (1 <= width <= _LARGEST_SIDE and 1 <= height <= _LARGEST_SIDE):
        raise SettingError(f"the film's sides must be between 1 and {_LARGEST_SIDE} pixels, not {width} x {height}")
    return width, height


def check_names(**names: Any) -> None:
    """``SettingError`` for names (of a structure, a filter, ...) that are neither strings nor None."""
    for what, value in names.items():
        if value is not None and not isinstance(value, str):
            raise SettingError(f"{what} must be a name, not {shown(value)}")


def check_integrator(integrator: Any) -> None:
    """``SettingError`` unless it is None, a name or a description."""
    if integrator is not None and not isinstance(integrator, str | Integrator):
        raise SettingError(f"integrator must be a name or a description of one, not {shown(integrator)}")


def check_work(film: Film, channels: int, samples: int, max_lanes: int) -> None:
    """``SettingError`` for films that do not fit into memory and for renders of more passes than anyone waits for."""
    pixels = film.crop_width * film.crop_height
    # Sums in float64 while a pass is added to them, and the image.
    need, have = pixels * (16 * (channels + 1) + 8 * channels), _memory()
    if have and need > have:
        message = f"a film of {film.crop_width} x {film.crop_height} x {channels} takes {need / 1e9:.0f} GB"
        raise SettingError(f"{message}, and there are {have / 1e9:.0f}; render it in crop windows")
    passes = pixels * samples // max(max_lanes, 1)
    if passes > _MOST_PASSES:
        message = f"{samples} samples of {pixels} pixels are {passes} passes, more than {_MOST_PASSES}"
        raise SettingError(f"{message}; take fewer samples, or average renders of several seeds")


def _memory() -> int:
    """Bytes that this process may have, as far as the system tells; 0 if it does not."""
    try:
        total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return 0
    try:
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    except ImportError:
        return total
    return min(total, limit) if limit > 0 else total
