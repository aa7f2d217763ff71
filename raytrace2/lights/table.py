"""All the lights of a scene, as one table that integrators sample and ask for densities.

Lights are numbered area lights first, then point, spot, directional, constant and environment-map lights; each
emissive shape is one light, and one light is chosen with probability 1 / count. Only the kinds that a scene has reach
the kernel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..errors import Problem, SceneError
from ..live import Slot
from ..scene import description
from ..types import Types
from .area import AreaLights
from .constant import ConstantEnvironment
from .directional import DirectionalLights
from .envmap import EnvironmentMap, check_rotation
from .envmap_live import envmap_slots
from .infinite import BoundingSphere
from .live import constant_slots, directional_slots, point_slots, spot_slots
from .point import PointLights
from .sample import LightSample, finite_or_zero
from .spot import SpotLights

NO_LIGHT = 0xFFFFFFFF


@dataclass(frozen=True, eq=False)
class LightTable:
    """``light_of_surface``: UInt buffer, per surface index the light that it is, or ``NO_LIGHT``; surfaces past its end
    (see :meth:`light_of`) do not emit. ``kinds``: the tables of the kinds present, each with its first light and count.
    ``has_area``, ``has_delta``, ``has_environment`` and ``count`` are Python values: what the scene has at all.
    ``slots``: where live values are held."""

    types: Types
    count: int
    has_area: bool
    has_delta: bool
    has_environment: bool
    light_of_surface: Any
    area: AreaLights | None
    environment_light: ConstantEnvironment | EnvironmentMap | None
    kinds: tuple[tuple[Any, Any, Any], ...]
    total: Any
    chance: Any
    surfaces: Any
    sphere: BoundingSphere
    slots: tuple[Slot, ...] = ()

    @staticmethod
    def build(
        lights: Sequence[description.Light],
        area: Sequence[tuple[int, description.Shape]],
        textures: Any,
        scene_bounds: tuple[np.ndarray, np.ndarray],
        types: Types,
    ) -> LightTable:
        """The table of ``lights`` and of the emissive shapes ``area``, each with its surface index.

        ``textures`` is a :class:`~raytrace2.textures.table.TextureTable`; textures join it here, so it is finished
        afterwards. ``scene_bounds`` are the corners of the scene's box, float64 (3,). Raises ``SceneError`` naming
        every light that cannot be represented.
        """
        check_lights(lights)
        sphere = BoundingSphere.of_box(*scene_bounds, types)
        point = [x for x in lights if isinstance(x, description.PointLight)]
        spot = [x for x in lights if isinstance(x, description.SpotLight)]
        directional = [x for x in lights if isinstance(x, description.DirectionalLight)]
        constant = [x for x in lights if isinstance(x, description.ConstantLight)]
        envmap = [x for x in lights if isinstance(x, description.EnvironmentLight)]

        area_table = AreaLights.build([shape for _, shape in area], textures, types) if area else None
        environment: list[ConstantEnvironment | EnvironmentMap] = [
            *(ConstantEnvironment.build(x, sphere, types) for x in constant),
            *(EnvironmentMap.build(x, sphere, types, textures.settings, textures.live) for x in envmap),
        ]
        tables: list[tuple[Any, int]] = []
        slots: list[Slot] = []
        if area_table:
            tables.append((area_table, len(area)))
            slots += area_table.slots([shape for _, shape in area], textures.live)
        if point:
            tables.append((PointLights.build(point, types), len(point)))
            slots += point_slots(tables[-1][0], point, textures.live)
        if spot:
            tables.append((SpotLights.build(spot, textures, types), len(spot)))
            slots += spot_slots(tables[-1][0], spot, textures.live)
        if directional:
            tables.append((DirectionalLights.build(directional, sphere, types), len(directional)))
            slots += directional_slots(tables[-1][0], directional, textures.live)
        tables.extend((x, 1) for x in environment)
        for sky, made in zip(constant, environment, strict=False):
            if isinstance(made, ConstantEnvironment):
                slots += constant_slots(made, sky, textures.live)
        for image, made in zip(envmap, environment, strict=False):
            if isinstance(made, EnvironmentMap):
                slots += envmap_slots(made, image, textures.live)

        count = len(lights) + len(area)
        kinds, first = [], 0
        for table, size in tables:
            kinds.append((table, dr.opaque(types.UInt, first), dr.opaque(types.UInt, size)))
            first += size
        surfaces = np.full(max((s for s, _ in area), default=-1) + 2, NO_LIGHT, dtype=np.uint32)
        if area_table:
            for light, which in enumerate(area_table.order):
                surfaces[area[which][0]] = light
        return LightTable(
            types,
            count,
            has_area=bool(area),
            has_delta=bool(point or spot or directional),
            has_environment=bool(environment),
            light_of_surface=types.UInt(surfaces),
            area=area_table,
            environment_light=environment[0] if environment else None,
            kinds=tuple(kinds),
            total=dr.opaque(types.Float, float(count)),
            chance=dr.opaque(types.Float, 1.0 / max(count, 1)),
            surfaces=dr.opaque(types.UInt, len(surfaces)),
            sphere=sphere,
            slots=tuple(slots),
        )

    def enclose(self, lo: np.ndarray, hi: np.ndarray) -> None:
        """Takes a new box around the scene."""
        sphere = BoundingSphere.of_box(lo, hi, self.types)
        for name in ("center", "radius"):
            object.__setattr__(self.sphere, name, getattr(sphere, name))

    def sample(self, p: Any, sample2: Any, active: Any) -> LightSample:
        """A direction from ``p`` (Array3f) towards a light, from ``sample2`` (Array2f in [0, 1)^2).

        ``sample2.x`` first chooses the light; what remains of it is stretched to [0, 1) and used again.
        """
        types = self.types
        if not self.kinds:
            zero = dr.zeros(types.Array3f)
            return LightSample(zero, types.Float(0), zero, types.Float(0), types.Bool(False), p)
        index, u = types.UInt(0), sample2
        if self.count > 1:
            scaled = sample2.x * self.total
            index = types.UInt(dr.fmin(scaled, self.total - 1))
            u = types.Array2f(dr.fmin(dr.fmax(scaled - types.Float(index), 0), 1 - 2 * types.epsilon), sample2.y)
        result: Any = None
        for table, first, count in self.kinds:
            mine = active if len(self.kinds) == 1 else active & (index >= first) & (index - first < count)
            if isinstance(table, ConstantEnvironment | EnvironmentMap):
                drawn = table.sample(p, u, mine)
            elif isinstance(table, AreaLights):
                drawn = table.sample(p, index - first, u, mine)
            else:
                drawn = table.sample(p, index - first, mine)
            result = drawn if result is None else dr.select(mine, drawn, result)
        if self.count > 1:
            weight, pdf = finite_or_zero(result.weight * self.total, result.pdf * self.chance, active)
            result = LightSample(result.d, result.dist, weight, pdf, result.delta, result.p)
        return result

    def light_of(self, surface: Any, active: Any) -> Any:
        """The light (UInt) that surface ``surface`` is, or ``NO_LIGHT``."""
        if not self.has_area:
            return self.types.UInt(NO_LIGHT)
        known = active & (surface < self.surfaces)
        return dr.select(known, dr.gather(self.types.UInt, self.light_of_surface, surface, known), NO_LIGHT)

    def radiance_at(self, si: Any, light: Any, active: Any) -> Any:
        """Radiance (Array3f) that the area light ``light`` sends from the hit ``si`` along ``si.wi``; 0 from the back
        (as the shading frame has it) and for ``NO_LIGHT``."""
        if self.area is None:
            return dr.zeros(self.types.Array3f)
        return self.area.eval(si, light, active & (light != NO_LIGHT))

    def environment(self, d: Any, active: Any) -> Any:
        """Radiance (Array3f) that rays of unit direction ``d`` meet when they leave the scene."""
        return self.environment_with_pdf(d, active)[0]

    def pdf_environment(self, d: Any, active: Any) -> Any:
        """The density per steradian with which :meth:`sample` takes the direction ``d`` of the environment."""
        return self.environment_with_pdf(d, active)[1]

    @property
    def filters_environment(self) -> bool:
        """Whether the environment is an image that heeds how directions change from sample to sample."""
        return isinstance(self.environment_light, EnvironmentMap) and self.environment_light.filtered is not None

    def environment_with_pdf(self, d: Any, active: Any, turns: Any = None) -> tuple[Any, Any]:
        """:meth:`environment` and :meth:`pdf_environment` by one lookup; ``turns`` (two Array3f) are the changes of
        ``d`` towards the next samples, over which an image is filtered."""
        if self.environment_light is None:
            return dr.zeros(self.types.Array3f), dr.zeros(self.types.Float)
        radiance, pdf = self.environment_light.eval_pdf(d, active)
        if turns is not None and isinstance(self.environment_light, EnvironmentMap):
            radiance = self.environment_light.eval_over(d, turns, active)
        return radiance, pdf * self.chance

    def pdf_hit(self, p: Any, si: Any, light: Any, active: Any) -> Any:
        """The density per steradian with which :meth:`sample` from ``p`` finds the hit ``si`` on light ``light``."""
        if self.area is None:
            return dr.zeros(self.types.Float)
        return self.area.pdf(p, si, light, active & (light != NO_LIGHT)) * self.chance


def check_lights(lights: Sequence[description.Light]) -> None:
    """``SceneError`` naming every light that cannot be."""
    problems = []
    infinite = [x for x in lights if isinstance(x, description.ConstantLight | description.EnvironmentLight)]
    if len(infinite) > 1:
        problems.append(Problem(f"{len(infinite)} environment lights", None, "keep at most one constant or envmap"))
    for light in lights:
        name = type(light).__name__
        numbers = [
            np.asarray(v, dtype=np.float64).ravel()
            for k, v in vars(light).items()
            if k not in ("pixels", "filename", "texture")
        ]
        if not np.isfinite(np.concatenate(numbers)).all():
            problems.append(Problem(f"{name} with a parameter that is not finite", None, "use finite numbers"))
        elif isinstance(light, description.DirectionalLight) and not any(light.direction):
            problems.append(Problem(f"{name} without a direction", None, "give a direction other than 0 0 0"))
        elif isinstance(light, description.SpotLight) and not np.linalg.det(light.to_world[:3, :3]):
            problems.append(Problem(f"{name} with a to_world that cannot be inverted", None, "remove the zero scale"))
        elif isinstance(light, description.EnvironmentLight):
            check_rotation(light)
    if problems:
        raise SceneError(problems)
