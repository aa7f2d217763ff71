"""What integrators share about lights that rays meet by themselves."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..rays.differentials import turns
from ..rays.ray import Ray
from ..scene.traced import TracedScene
from ..surfaces.hit import Hit
from ..surfaces.interaction import SurfaceInteraction


def power_heuristic(a: Any, b: Any) -> Any:
    """The weight of a sample of density ``a`` where another technique has density ``b`` (Veach 1997, 9.2.4)."""
    # Squares of the densities themselves would overflow where a light is small and far away.
    ratio = b / dr.select(a > 0, a, 1)
    return dr.select(a > 0, dr.rcp(dr.fma(ratio, ratio, 1)), 0)


def met_emission(
    scene: TracedScene,
    origin: Any,
    ray: Ray,
    si: SurfaceInteraction,
    pdf: Any,
    delta: Any,
    active: Any,
    differential: Any = None,
) -> Any:
    """Radiance (Array3f) of the light that ``ray`` met or escaped to, weighted against sampling it from ``origin``.

    ``pdf`` is the density with which the material chose the ray; where ``delta``, lights could not have been sampled.
    ``differential`` is that of ``ray``, for images at infinity that are filtered where ``delta``.
    """
    lights = scene.lights
    result = scene.types.Array3f(0)
    if lights.has_area:
        light = lights.light_of(si.surface, active & si.valid)
        shines = active & si.valid & (light != 0xFFFFFFFF)
        weight = power_heuristic(pdf, dr.select(delta, 0, lights.pdf_hit(origin, si, light, shines & ~delta)))
        result += dr.select(shines, lights.radiance_at(si, light, shines) * weight, 0)
    if lights.has_environment:
        escapes = active & ~si.valid
        around = turns(ray.d, differential) if lights.filters_environment else None
        if around is not None:
            # Where lights are sampled as well, wide footprints would bring light from below the horizon of a lobe.
            around = tuple(dr.select(delta, v, 0) for v in around)
        radiance, light_pdf = lights.environment_with_pdf(ray.d, escapes, around)
        weight = power_heuristic(pdf, dr.select(delta, 0, light_pdf))
        result += dr.select(escapes, radiance * weight, 0)
    return result


def past_emitters(scene: TracedScene, ray: Ray, hit: Hit, active: Any) -> Hit:
    """The first hit of each ray that does not emit, for images that hide their lights."""
    lights, structure = scene.lights, scene.structure
    if not lights.has_area:
        return hit

    def on_emitter(hit: Hit) -> Any:
        return active & hit.valid & (lights.light_of(hit.surface, active & hit.valid) != 0xFFFFFFFF)

    def step(hit: Hit, start: Any) -> tuple[Hit, Any]:
        si = structure.interact(ray, hit)
        beyond = structure.intersect(si.spawn_ray(ray.d), True)
        travelled = start + dr.norm(si.p - ray(start)) * dr.rcp(dr.norm(ray.d))
        beyond.t = dr.select(beyond.valid, beyond.t + travelled, beyond.t)
        return beyond, travelled

    zero = dr.zeros(type(hit.t), dr.width(hit.t))
    return dr.while_loop((hit, zero), lambda h, _: on_emitter(h), step, label="past emitters")[0]
