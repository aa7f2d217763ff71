"""Points of lights whose shadows are looked at, chosen the same way wherever they shine."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import drjit as dr

from .. import warp
from ..integrators.emission import power_heuristic
from ..lights.area import AreaLights
from ..lights.area_sphere import SphereLights
from ..lights.point import PointLights
from ..lights.spot import SpotLights
from ..rays.ray import Ray
from ..scene.traced import TracedScene
from .round_curves import Eye


@dataclass(frozen=True, eq=False)
class LightKind:
    """The lights ``first`` to ``first + count`` (UInt) of ``scene``; ``spheres`` is their table if they are spheres.
    ``parallel``: they are at infinity."""

    scene: TracedScene
    first: Any
    count: Any
    parallel: bool
    spheres: SphereLights | None = None

    @staticmethod
    def all(scene: TracedScene) -> Iterator[LightKind]:
        """Every kind of light that ``scene`` has."""
        for table, first, count in scene.lights.kinds:
            if isinstance(table, AreaLights):
                for inner, start, some in table.kinds:
                    yield LightKind(scene, start, some, False, inner if isinstance(inner, SphereLights) else None)
            else:
                yield LightKind(scene, first, count, not isinstance(table, PointLights | SpotLights))

    @property
    def share(self) -> Any:
        """Of all lights, which part these are."""
        return self.scene.types.Float(self.count) * self.scene.lights.chance

    def eye(self, u: Any) -> Eye:
        """The point, or the direction towards it, that ``u`` (Array2f in [0, 1)^2) stands for, wherever it is seen
        from.

        With derivatives if the light has them."""
        t = self.scene.types
        if self.spheres is not None:
            center, radius, _, way = self._on_sphere(u)
            return Eye(dr.fma(way, radius, center), False)
        nowhere = dr.zeros(t.Array3f, dr.width(u))
        sample = self.scene.lights.sample(nowhere, self._chosen(u), t.Bool(True))
        return Eye(sample.d if self.parallel else sample.p, self.parallel)

    def rounded(self, u: Any) -> Any:
        """Which light (UInt) the point ``u`` is on if it is a sphere, whose outline hides none of what is sampled of
        it; None for others."""
        return None if self.spheres is None else self.first + self._on_sphere(u)[2]

    def eye_for(self, u: Any, eye: Eye, p: Any, active: Any) -> Eye:
        """``eye``, the one for ``u``, as sampling lights from ``p`` (Array3f) moves it: by what the light does, and
        with ``p`` where the light's points are chosen by how they are seen from there."""
        if self.spheres is None:
            return self.eye(u)
        _, _, index, _ = self._on_sphere(u)
        same = dr.detach(self.spheres.inverse(p, index, eye.at, active))
        moved = self.spheres.sample(p, index, same, active).p
        return Eye(dr.replace_grad(eye.at, moved), False)

    def light(self, si: Any, u: Any, material: Any, share: Any, active: Any) -> Any:
        """What that point brings to the surface ``si`` and on along ``si.wi`` (Array3f) as far as lights are sampled
        for it, over the density of ``u``: an integral over it is that part of direct light. Of materials, ``share``
        times as many samples are taken as of lights."""
        scene, t = self.scene, self.scene.types
        materials, structure = scene.materials, scene.structure
        lit = active & materials.has_smooth(material, active)
        if self.spheres is None:
            light = scene.lights.sample(si.p, self._chosen(u), lit)
            lit &= light.pdf > 0
            value, bsdf_pdf = materials.eval_pdf(si, material, si.to_local(light.d), lit)
            lit &= dr.max(value) > 0
            lit &= ~structure.occluded(si.spawn_ray_to(light.p), lit)
            weight = dr.select(light.delta, 1, power_heuristic(light.pdf, bsdf_pdf * share))
            return dr.select(lit, value * light.weight * weight, 0) * self.share
        center, radius, index, way = self._on_sphere(u)
        target = dr.fma(way, radius, center)
        offset = target - si.p
        distance = dr.norm(offset)
        d = offset / dr.select(distance > 0, distance, 1)
        value, bsdf_pdf = materials.eval_pdf(si, material, si.to_local(d), lit)
        ray = si.spawn_ray(d)
        lit &= (dr.max(value) > 0) & (distance > 0)
        met = structure.interact(ray, structure.intersect(ray, lit))
        # What is met is that point, and not one that hides it: a part in a thousand of the way tells these apart.
        lit &= met.valid & (dr.norm(met.p - target) < distance * 1e-3)
        number = scene.lights.light_of(met.surface, lit)
        lit &= number == self.first + index
        radiance = scene.lights.radiance_at(met, number, lit)
        weight = dr.abs(dr.dot(way, d)) * dr.square(radius / dr.select(lit, distance, 1)) * (4 * dr.pi)
        weight *= power_heuristic(scene.lights.pdf_hit(si.p, met, number, lit), bsdf_pdf * share)
        return dr.select(lit, value * radiance * weight, 0) * t.Float(self.count)

    def _chosen(self, u: Any) -> Any:
        """``u`` that makes the table of all lights choose one of these."""
        t, lights = self.scene.types, self.scene.lights
        return t.Array2f((t.Float(self.first) + u.x * t.Float(self.count)) * lights.chance, u.y)

    def _on_sphere(self, u: Any) -> tuple[Any, Any, Any, Any]:
        assert self.spheres is not None
        t = self.scene.types
        scaled = u.x * t.Float(self.count)
        index = dr.minimum(t.UInt(scaled), self.count - 1)
        center, radius, _ = self.spheres.sphere(index, t.Bool(True))
        rest = dr.fmax(dr.fmin(scaled - t.Float(index), 1 - 2 * t.epsilon), 0)
        return center, radius, index, warp.square_to_uniform_sphere(t.Array2f(rest, u.y))


def ray_past(eye: Eye, x: Any, largest: Any, epsilon: float) -> Ray:
    """The ray on from ``x`` that comes from ``eye``: what it meets is in the shadow of ``x``. Of points, t is 1 at
    ``x``."""
    start = epsilon**0.5 / 2
    if eye.parallel:
        return Ray.of(x, -eye.at + 0 * x, largest * start, dr.inf)
    return Ray.of(eye.at + 0 * x, x - eye.at, 1 + start, dr.inf)
