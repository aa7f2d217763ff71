"""Direct illumination: emitter and material sampling combined by multiple importance sampling."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..rays.differentials import NO_DIFFERENTIALS, Bouncing
from ..rays.ray import Ray
from ..scene.description import Integrator
from ..scene.traced import TracedScene
from .emission import met_emission, power_heuristic
from .tracing import StructureTracing, Tracing, held, scatters


def direct(
    scene: TracedScene,
    settings: Integrator,
    sampler: Any,
    ray: Ray,
    active: Any = True,
    *,
    differentials: Bouncing = NO_DIFFERENTIALS,
    differential: Any = None,
    tracing: Tracing | None = None,
) -> Any:
    """Radiance (Array3f) along each ray of light that scatters at most once.

    ``differentials`` say how rays carry footprints, ``differential`` is that of ``ray``. With a ``tracing`` other than
    the scene's own the samples of a point are not taken in a loop.

    ``settings.emitter_samples`` and ``settings.bsdf_samples`` rays are traced from each point, in symbolic loops; the
    sampler's numbers are drawn in Mitsuba's order, but none for what is not in the kernel.
    """
    t = scene.types
    structure, materials, lights = scene.structure, scene.materials, scene.lights
    width = len(ray)
    active = dr.full(t.Bool, True, width) & active
    total = settings.emitter_samples + settings.bsdf_samples
    light_share, bsdf_share = settings.emitter_samples / total, settings.bsdf_samples / total

    loops = tracing is None
    tracing = StructureTracing(scene) if tracing is None else tracing
    hit = tracing.closest(ray, active, t.Bool(True) if settings.hide_emitters else None)
    meeting = differentials.meet(structure, ray, differential, hit)
    if scene.draws_texels:
        meeting = meeting.drawing(sampler.next_2d())
    si = meeting.si
    result = dr.zeros(t.Array3f, width)
    if not settings.hide_emitters:
        result += met_emission(scene, ray.o, ray, si, t.Float(1), t.Bool(True), active, differential)
    active &= si.valid
    material = scene.material(si, active)

    def sample_light(i: Any, result: Any, sampler: Any) -> tuple[Any, Any, Any]:
        si = meeting.inside(loops and settings.emitter_samples > 1).si
        lit = active & materials.has_smooth(material, active)
        light = lights.sample(si.p, sampler.next_2d(), lit)
        lit &= light.pdf > 0
        value, bsdf_pdf = materials.eval_pdf(si, material, si.to_local(light.d), active)
        lit &= scatters(value, bsdf_pdf, tracing)
        lit &= ~tracing.blocked(si.spawn_ray_to(light.p), lit)
        weight = power_heuristic(light.pdf * light_share, bsdf_pdf * bsdf_share)
        weight = dr.select(light.delta, 1, weight) / settings.emitter_samples
        return i + 1, dr.select(lit, result + value * light.weight * weight, result), sampler

    def sample_material(i: Any, result: Any, sampler: Any) -> tuple[Any, Any, Any]:
        here = meeting.inside(loops and settings.bsdf_samples > 1)
        scatter = here.scatter
        # Mitsuba draws the pair first here, and second in its path tracer.
        pair = sampler.next_2d()
        sample = materials.sample(scatter, material, sampler.next_1d(), pair, active)
        if tracing.holds_directions:
            sample = held(scene, here, material, sample, active)
        onward = scatter.spawn_ray(scatter.to_world(sample.wo))
        left = None
        if differential is not None:
            left = differentials.leave(here, sample, onward, differential)
            if not tracing.keeps_gradients:
                onward, sample = dr.detach(onward), dr.detach(sample)
        useful = active & scatters(sample.weight, sample.pdf, tracing)
        beyond = differentials.meet(structure, onward, left, tracing.closest(onward, useful, None))
        if scene.draws_texels:
            beyond = beyond.drawing(sampler.next_2d())
        met = beyond.si
        if settings.emitter_samples:
            pdf, alone = sample.pdf * (bsdf_share / light_share), sample.delta
        else:
            pdf, alone = sample.pdf, t.Bool(True)
        emitted = met_emission(scene, si.p, onward, met, pdf, alone, useful, left)
        return i + 1, dr.select(useful, result + sample.weight * emitted / settings.bsdf_samples, result), sampler

    counter = dr.zeros(t.UInt, width)
    if settings.emitter_samples and materials.has_smooth_any and lights.count:
        _, result, sampler = _repeat(settings.emitter_samples, sample_light, (counter, result, sampler), active, loops)
    if settings.bsdf_samples and (lights.has_area or lights.has_environment):
        _, result, sampler = _repeat(
            settings.bsdf_samples, sample_material, (counter + 0, result, sampler), active, loops
        )
    return result


def _repeat(times: int, body: Any, state: tuple[Any, ...], active: Any, loops: bool) -> tuple[Any, ...]:
    if loops and times > 1:
        found: tuple[Any, ...] = dr.while_loop(state, lambda i, *_: active & (i < times), body)
        return found
    for _ in range(times):
        state = body(*state)
    return state
