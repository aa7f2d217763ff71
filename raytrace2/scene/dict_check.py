"""What Mitsuba's dict parser can be given: other values than these it refuses in many lines, or dies of."""

from __future__ import annotations

import math
import os
import stat
from typing import Any

import numpy as np

from ..arguments import shown
from ..errors import Location, Problem, SceneError
from .xml_text import MAX_DEPTH

DICT_SOURCE = "<dict>"
_LARGEST = 2**63 - 1
_NUMBERS = (bool, int, float, np.number, np.bool_)


def check_dict(scene: dict[str, Any]) -> None:
    """``SceneError`` that names the path of keys to the first value that is nothing a scene can hold.

    Dicts nest at most 100 deep (and do not contain themselves), keys are strings, values are numbers, strings, dicts,
    short sequences of numbers, arrays, and objects of Mitsuba and Dr.Jit.
    """
    _check(scene, "", 0)


def _check(node: dict[Any, Any], path: str, depth: int) -> None:
    if depth > MAX_DEPTH:
        message = f"dicts are nested more than {MAX_DEPTH} deep, or a dict contains itself"
        raise _error(message, "", "give the inner object an id and refer to it")
    for key, value in node.items():
        if not isinstance(key, str) or not key.isprintable():
            raise _error(f"the key {shown(key)} is no name", path, "keys are strings")
        where = f"{path}.{key}" if path else key
        if key in ("type", "id") and not isinstance(value, str):
            raise _error(f"'{key}' must be a string, not {shown(value)}", where, f"give the {key} as a name")
        if isinstance(value, dict):
            if "type" not in value:
                raise _error("has no 'type'", where, "every dict in a scene has one")
            _check(value, where, depth + 1)
        else:
            _check_value(value, key, where, _is_spectrum(node))


def _is_spectrum(node: dict[Any, Any]) -> bool:
    return node.get("type") in ("spectrum", "rgb")


def _check_value(value: Any, key: str, where: str, spectrum: bool) -> None:
    if isinstance(value, str):
        if "\0" in value or any(0xD800 <= ord(c) < 0xE000 for c in value):
            raise _error(f"the string {shown(value)} cannot be encoded", where, "use plain text")
        if spectrum and key == "filename" and os.path.exists(value) and not stat.S_ISREG(os.stat(value).st_mode):
            raise _error(f"'{value}' is not a regular file", where, "give the path of a file")
    elif isinstance(value, _NUMBERS):
        if isinstance(value, int | np.integer) and abs(int(value)) > _LARGEST:
            raise _error(f"the number {shown(value)} is too large", where, "integers have at most 63 bits")
    elif isinstance(value, list | tuple):
        _check_sequence(value, where, spectrum)
    elif isinstance(value, np.ndarray):
        if value.dtype.kind not in "fiub":
            raise _error(f"an array of {value.dtype} cannot be read", where, "use floats or integers")
    elif not _is_known(value):
        raise _error(f"a value of type {type(value).__name__} cannot be read", where, "use numbers, strings and dicts")


def _check_sequence(value: Any, where: str, spectrum: bool) -> None:
    """Numbers, or for spectra pairs of numbers."""
    pairs = spectrum and len(value) > 0 and all(isinstance(v, list | tuple) and len(v) == 2 for v in value)
    if not all(isinstance(v, _NUMBERS) for row in (value if pairs else [value]) for v in row):
        raise _error(f"{shown(value)} is no list of numbers", where, "give plain numbers")
    if not pairs and len(value) == 0:
        raise _error("an empty list", where, "give numbers or leave it out")
    largest = max(abs(float(v)) if _fits(v) else math.inf for row in (value if pairs else [value]) for v in row)
    if largest == math.inf:
        raise _error(f"{shown(value)} has a number that is infinite or too large", where, "use finite numbers")


def _fits(value: Any) -> bool:
    return not isinstance(value, int) or abs(value) <= _LARGEST


def _is_known(value: Any) -> bool:
    module = type(value).__module__
    return not isinstance(value, type) and module.partition(".")[0] in ("mitsuba", "drjit")


def _error(message: str, path: str, remedy: str) -> SceneError:
    return SceneError([Problem(message, Location(f"{DICT_SOURCE}[{path}]" if path else DICT_SOURCE), remedy)])
