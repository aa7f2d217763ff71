"""Which properties of a PLY element become mesh attributes, under which names, as in Mitsuba 3.9.1.

``r g b [a]`` (or red, green, blue, alpha) become ``color``; consecutive properties ``p_x p_y p_z``, ``p_0 p_1 p_2``
or ``p_1 p_2 p_3`` become ``p``, ``p_r p_g p_b`` becomes ``p_color``, and the first of them alone makes an attribute of
one channel.
Properties that fit no such scheme carry no attribute.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...errors import FileError
from .ply_header import Element

_SCHEMES = ("xyzw", "rgba", "0123", "1234")
_GEOMETRY = {"x", "y", "z", "nx", "ny", "nz", "u", "v"}


def attribute_groups(element: Element, taken: set[int], name: str) -> dict[str, list[int]]:
    """Attribute name -> the fields it consists of, for ``element``; ``taken`` are fields that already have a meaning.

    :class:`FileError` (naming the file ``name``) if two groups would get one name.
    """
    groups: list[tuple[str, list[int]]] = []
    colour = _colour(element)
    if colour:
        groups.append((f"{element.name}_color", colour))
    skip = taken | set(colour)
    skip |= {i for i, f in enumerate(element.fields) if f.role != "value" or f.name in {"r", "g", "b", "a"}}
    if element.name == "vertex":
        skip |= {i for i, f in enumerate(element.fields) if f.name in _GEOMETRY}

    seen: set[str] = set()
    for prefix, run in _runs(element, skip):
        scheme = next((s for s in _SCHEMES if element.fields[run[0]].name[-1] == s[0]), None)
        letters = "".join(element.fields[i].name[-1] for i in run)
        if prefix in seen or scheme is None or len(run) not in (1, 3) or not scheme.startswith(letters):
            continue
        seen.add(prefix)
        groups.append((f"{element.name}_{prefix}{'_color' if scheme == 'rgba' else ''}", run))
    names = [g[0] for g in groups]
    for attribute in names:
        if names.count(attribute) > 1:
            remedy = "rename the properties of one of them"
            raise FileError(f"two groups of properties make the attribute '{attribute}'", name, element.line, remedy)
    return dict(groups)


def attribute_values(element: Element, fields: list[int], column: Callable[[int], np.ndarray]) -> np.ndarray:
    """The (count, channels) array of an attribute: floats as they are, uchar as 0 to 255, other integers as sRGB.

    Mitsuba takes integers other than uchar for sRGB-encoded values in [0, 1] and makes them linear.
    """
    columns = []
    for i in fields:
        values, code = column(i), element.fields[i].code
        if code[0] != "f" and code != "u1":
            encoded = values.astype(np.float64) / np.iinfo(code).max
            curve = ((np.maximum(encoded, 0.04045) + 0.055) / 1.055) ** 2.4
            values = np.where(encoded <= 0.04045, encoded / 12.92, curve)
        columns.append(values.astype(np.float64 if code == "f8" else np.float32))
    return np.stack(columns, axis=1)


def _colour(element: Element) -> list[int]:
    for names in (("r", "g", "b", "a"), ("red", "green", "blue", "alpha")):
        found = [element.index(n) for n in names]
        if None not in found[:3]:
            return [i for i in found if i is not None]
    return []


def _runs(element: Element, skip: set[int]) -> list[tuple[str, list[int]]]:
    """Maximal runs of fields named ``prefix_c`` with one prefix and a one-letter ``c``."""
    runs: list[tuple[str, list[int]]] = []
    joins = False
    for i, field in enumerate(element.fields):
        if i in skip:
            continue
        prefix, underscore, letter = field.name.rpartition("_")
        if not underscore or len(letter) != 1:
            joins = False
        elif joins and runs[-1][0] == prefix:
            runs[-1][1].append(i)
        else:
            runs.append((prefix, [i]))
            joins = True
    return runs
