"""How the records of lights without a surface follow from values that may change."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi
from typing import Any

import drjit as dr

from ..live import Live, Place, Slot, Values, channels, put
from ..scene import description
from ..surfaces.shading_slots import affine_rows
from .constant import ConstantEnvironment
from .directional import DirectionalLights
from .point import PointLights
from .spot import SpotLights


def point_slots(table: PointLights, lights: Sequence[description.PointLight], live: Live) -> list[Slot]:
    """Those of point lights."""
    writes = _Writes()
    for k, light in enumerate(lights):
        writes.add(live.place(light, "position"), 8 * k, list)
        writes.add(live.place(light, "intensity"), 8 * k + 4, channels)
    return writes.slots(table, moves=any(live.has(light, "position") for light in lights))


def directional_slots(
    table: DirectionalLights, lights: Sequence[description.DirectionalLight], live: Live
) -> list[Slot]:
    """Those of directional lights."""
    writes = _Writes()
    for k, light in enumerate(lights):
        writes.add(live.place(light, "direction"), 8 * k, _towards)
        writes.add(live.place(light, "irradiance"), 8 * k + 4, channels)
    return writes.slots(table, moves=any(live.has(light, "direction") for light in lights))


def spot_slots(table: SpotLights, lights: Sequence[description.SpotLight], live: Live) -> list[Slot]:
    """Those of spot lights."""
    writes = _Writes()
    for k, light in enumerate(lights):
        first = 20 * k
        writes.add(live.place(light, "intensity"), first + 16, channels)
        placed = live.place(light, "to_world")
        for row in range(3):
            writes.add(placed, first + 4 * row, lambda value, row=row: affine_rows(value)[1][4 * row : 4 * row + 3])
        writes.add(placed, first + 12, lambda value: affine_rows(value)[0][3::4])
    found = writes.slots(table, moves=any(live.has(light, "to_world") for light in lights))
    angles = {
        k: (live.place(light, "cutoff_angle"), live.place(light, "beam_width"))
        for k, light in enumerate(lights)
        if live.has(light, "cutoff_angle", "beam_width")
    }
    if not angles:
        return found

    def make(base: Any, values: Values) -> Any:
        buffer = type(base)(found[0].made(values) if found else base)
        for k, (cutoff, beam) in angles.items():
            pair = [type(base)(lights[k].cutoff_angle), type(base)(lights[k].beam_width)]
            outer, inner = (
                (value if place is None else values(place)) * (pi / 180)
                for place, value in zip((cutoff, beam), pair, strict=True)
            )
            wide = outer > inner
            steepness = dr.select(wide, 1 / dr.select(wide, outer - inner, 1), 0)
            for row, word in enumerate((dr.tan(outer), outer, inner, steepness)):
                put(buffer, 20 * k + 4 * row + 3, [word])
        return buffer

    places = [p for pair in angles.values() for p in pair if p is not None] + list(found[0].places if found else ())
    return [Slot.of(table, "records", places, make, moves=bool(found) and found[0].moves)]


def constant_slots(table: ConstantEnvironment, light: description.ConstantLight, live: Live) -> list[Slot]:
    """That of a constant environment."""
    place = live.place(light, "radiance")

    def make(base: Any, values: Values) -> Any:
        return type(base)(*channels(values(place)))  # type: ignore[arg-type]

    return [] if place is None else [Slot.of(table, "radiance", [place], make, moves=False)]


class _Writes:
    """Words of records, by the place that they follow from."""

    def __init__(self) -> None:
        self._writes: list[tuple[Place, int, Any]] = []

    def add(self, place: Place | None, first: int, words: Any) -> None:
        """``words`` of the value of ``place`` stand from word ``first`` on."""
        if place is not None:
            self._writes.append((place, first, words))

    def slots(self, table: Any, *, moves: bool) -> list[Slot]:
        """The one slot, or none if nothing was added."""

        def make(base: Any, values: Values) -> Any:
            buffer = type(base)(base)
            for place, first, words in self._writes:
                put(buffer, first, words(values(place)))
            return buffer

        return [Slot.of(table, "records", {p for p, _, _ in self._writes}, make, moves=moves)] if self._writes else []


def _towards(matrix: Any) -> list[Any]:
    axis = [matrix[k, 2] for k in range(3)]
    inverse = -dr.rsqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2])
    return [x * inverse for x in axis]
