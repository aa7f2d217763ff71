# ruff: noqa: E501 -- a case a line
"""What became of a case: fine, refused in one line, or one of the ways in which a program fails its users."""

from __future__ import annotations

import linecache
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

import raytrace2 as rt

PACKAGE = Path(rt.__file__).parent

FINE, REFUSED = "fine", "refused"
#: An error over several lines or without words, an exception that nobody raised on purpose, an answer that is wrong.
LINES, EXCEPTION, NONSENSE = "several lines", "other exception", "silent nonsense"
#: What only the parent of a process sees.
SIGNAL, HANG = "signal", "hang"
BUGS = (LINES, EXCEPTION, NONSENSE, SIGNAL, HANG)
LONGEST_LINE = 2000


class Nonsense(Exception):
    """Input that had to be refused was not, or a result is not what it must be."""


def judge(action: Callable[[], Any]) -> tuple[str, str]:
    """The class of what ``action()`` does, and the message that goes with it."""
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            action()
    except Nonsense as error:
        return NONSENSE, str(error)
    except (rt.RayTraceError, TypeError, ValueError) as error:
        return _of_error(error)
    except Exception as error:
        return EXCEPTION, _place(error)
    told = [str(w.message) for w in caught if issubclass(w.category, RuntimeWarning)]
    return FINE, told[0] if told else ""


def _of_error(error: Exception) -> tuple[str, str]:
    text = str(error)
    if not isinstance(error, rt.RayTraceError) and not _on_purpose(error):
        return EXCEPTION, _place(error)
    problems = error.problems if isinstance(error, rt.SceneError) else (text,)
    lines = text.split("\n")
    plain = all(line.strip() and len(line) <= LONGEST_LINE and line.isprintable() for line in lines)
    return (REFUSED if plain and len(lines) == len(problems) else LINES), text


def _on_purpose(error: Exception) -> bool:
    """Whether a ``raise`` of ours made it."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    source = linecache.getline(last.filename, last.lineno or 0)
    return Path(last.filename).is_relative_to(PACKAGE) and source.strip().startswith("raise")


def _place(error: Exception) -> str:
    own = [f for f in traceback.extract_tb(error.__traceback__) if Path(f.filename).is_relative_to(PACKAGE)]
    where = f"{Path(own[-1].filename).relative_to(PACKAGE)}:{own[-1].lineno}" if own else "outside"
    return f"{type(error).__name__} at {where}: {str(error)[:300]!r}"


def require_sane(description: Any) -> None:
    """:class:`Nonsense` for numbers in a scene that are not finite (distances and such may be negative, sizes not)."""
    for name, value in numbers_in(description):
        if not np.all(np.isfinite(value)):
            raise Nonsense(f"{name} is {value}"[:300])
        if name in _POSITIVE and not np.all(np.asarray(value) > 0):
            raise Nonsense(f"{name} is {value}"[:300])
        if name in _NOT_NEGATIVE and not np.all(np.asarray(value) >= 0):
            raise Nonsense(f"{name} is {value}"[:300])


_POSITIVE = {
    "int_ior", "ext_ior", "width", "height", "crop_width", "crop_height", "stddev", "lobes", "near_clip", "far_clip", "x_fov",
    "aperture_radius", "focus_distance", "sample_count", "cutoff_angle",
}  # fmt: skip
_NOT_NEGATIVE = {"intensity", "irradiance", "crop_offset_x", "crop_offset_y", "seed"}


def numbers_in(value: Any, name: str = "", seen: set[int] | None = None) -> Iterator[tuple[str, Any]]:
    """Every number and array of numbers in a description, with the name of its field."""
    seen = set() if seen is None else seen
    if isinstance(value, bool | str) or value is None or id(value) in seen:
        return
    if isinstance(value, int | float):
        yield name, value
    elif isinstance(value, np.ndarray):
        yield name, value
    elif is_dataclass(value):
        seen.add(id(value))
        for item in fields(value):
            yield from numbers_in(getattr(value, item.name), item.name, seen)
    elif isinstance(value, tuple | list):
        for item in value:
            yield from numbers_in(item, name, seen)
    elif isinstance(value, dict):
        for key, item in value.items():
            yield from numbers_in(item, str(key), seen)


def render_small(scene: rt.Scene) -> None:
    """The scene at 4 x 4 pixels, every pixel of which must be a number."""
    require_sane(scene.description)
    if not scene.description.cameras:
        return
    image = np.array(rt.render(scene, size=(4, 4), spp=1))
    if image.shape[:2] != crop_shape(scene) or not np.isfinite(image).all():
        raise Nonsense(f"an image of shape {image.shape} with {np.sum(~np.isfinite(image))} values not finite")


def crop_shape(scene: rt.Scene) -> tuple[int, int]:
    from raytrace2.render import choose_camera

    film = choose_camera(scene, 0, (4, 4)).film
    return film.crop_height, film.crop_width
