"""Path tracing with emitter sampling, multiple importance sampling and Russian roulette, one symbolic loop per pass."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..rays.differentials import NO_DIFFERENTIALS, Bouncing, Differentials
from ..rays.ray import Ray
from ..scene.description import Integrator
from ..scene.traced import TracedScene
from .emission import met_emission, power_heuristic
from .tracing import StructureTracing, Tracing, held, scatters

#: From this depth on, paths that carry nothing but derivatives end by chance.
_BLACK_DEPTH = 32


@dataclass
class PathState:
    """A path as its loop carries it: the ray that goes on, what it may still bring and what it has brought, and how the
    last surface chose it. ``eta`` is None where nothing refracts."""

    ray: Ray
    throughput: Any
    radiance: Any
    eta: Any
    depth: Any
    origin: Any
    pdf: Any
    delta: Any
    shown: Any
    active: Any
    differential: Any = None


def path(
    scene: TracedScene,
    settings: Integrator,
    sampler: Any,
    ray: Ray,
    active: Any = True,
    *,
    differentials: Differentials = NO_DIFFERENTIALS,
    differential: Any = None,
) -> Any:
    """Radiance (Array3f) along each ray.

    ``differentials`` say how rays carry footprints, ``differential`` is that of ``ray``.

    ``settings.max_depth`` counts as in Mitsuba: 1 shows emitters only, 2 direct light, -1 has no bound. The sampler's
    numbers are drawn in Mitsuba's order, but none for what is not in the kernel: only what the scene has (emitters met
    by rays, smooth materials) is.
    """
    t = scene.types
    width = len(ray)
    if settings.max_depth == 0:
        return dr.zeros(t.Array3f, width)
    state = start(scene, settings, ray, active, differential)
    limits = Limits.of(scene, settings)
    tracing = StructureTracing(scene)

    def step(state: PathState, sampler: Any) -> tuple[PathState, Any]:
        return bounce(scene, limits, state, sampler, differentials, tracing), sampler

    state, _ = dr.while_loop((state, sampler), lambda s, _: s.active, step, label="path")
    return dr.select(state.shown, state.radiance, 0)


@dataclass(frozen=True)
class Limits:
    """Where paths end, UInt on the device: no more than ``max_depth`` of them, and Russian roulette from ``rr_depth``.
    ``hides_emitters``: rays from the camera do not see lights."""

    max_depth: Any
    rr_depth: Any
    hides_emitters: bool

    @staticmethod
    def of(scene: TracedScene, settings: Integrator) -> Limits:
        """Those of ``settings``."""
        UInt = scene.types.UInt
        max_depth = dr.opaque(UInt, settings.max_depth if settings.max_depth >= 0 else 0xFFFFFFFF)
        return Limits(max_depth, dr.opaque(UInt, settings.rr_depth), settings.hide_emitters)


def start(
    scene: TracedScene, settings: Integrator, ray: Ray, active: Any = True, differential: Any = None
) -> PathState:
    """The state of a path whose first ray is ``ray``, with its ``differential``."""
    t, width = scene.types, len(ray)
    zero3 = dr.zeros(t.Array3f, width)
    false = dr.full(t.Bool, False, width)
    full_ray = Ray.of(ray.o + zero3, ray.d + zero3, ray.tmin + zero3.x, ray.tmax + zero3.x)
    return PathState(
        ray=full_ray,
        throughput=zero3 + 1,
        radiance=zero3 + 0,
        eta=dr.full(t.Float, 1, width) if scene.materials.has_refraction else None,
        depth=dr.zeros(t.UInt, width),
        origin=zero3 + 0,
        pdf=dr.full(t.Float, 1, width),
        delta=~false,
        shown=false | (not settings.hide_emitters),
        active=(~false) & active,
        differential=differential,
    )


def bounce(
    scene: TracedScene, limits: Limits, s: PathState, sampler: Any, differentials: Bouncing, tracing: Tracing
) -> PathState:
    """The state after the ray of ``s`` has met what it meets, which ``tracing`` tells, and has been scattered there.

    ``s`` is used up. What the bounce draws, it draws from ``sampler``.
    """
    t = scene.types
    structure, materials, lights = scene.structure, scene.materials, scene.lights
    hit = tracing.closest(s.ray, s.active, s.depth == 0 if limits.hides_emitters else None)
    meeting = differentials.meet(structure, s.ray, s.differential, hit)
    if scene.draws_texels:
        meeting = meeting.drawing(sampler.next_2d())
    si = meeting.si
    if lights.has_area or lights.has_environment:
        emitted = met_emission(scene, s.origin, s.ray, si, s.pdf, s.delta, s.active, s.differential)
        s.radiance = dr.fma(s.throughput, emitted, s.radiance)
    goes_on = s.active & si.valid & (s.depth + 1 < limits.max_depth)
    material = scene.material(si, goes_on)

    direct, lit, shadow_ray = None, None, None
    if materials.has_smooth_any and lights.count:
        lit = goes_on & materials.has_smooth(material, goes_on)
        light = lights.sample(si.p, sampler.next_2d(), lit)
        lit &= light.pdf > 0
        shadow_ray = si.spawn_ray_to(light.p)
        value, bsdf_pdf = materials.eval_pdf(si, material, si.to_local(light.d), goes_on)
        lit &= scatters(value, bsdf_pdf, tracing)
        weight = dr.select(light.delta, 1, power_heuristic(light.pdf, bsdf_pdf))
        direct = s.throughput * value * light.weight * weight

    # Before the shadow ray: Dr.Jit sees no two values as the same that are computed on either side of a traversal.
    scatter = meeting.scatter
    sample = materials.sample(scatter, material, sampler.next_1d(), sampler.next_2d(), goes_on)
    if tracing.holds_directions:
        sample = held(scene, meeting, material, sample, goes_on)
    onward = scatter.spawn_ray(scatter.to_world(sample.wo))
    # What lanes carry that do not go on means nothing.
    if s.differential is not None:
        s.differential = differentials.leave(meeting, sample, onward, s.differential)
        if not tracing.keeps_gradients:
            onward, sample = dr.detach(onward), dr.detach(sample)
    s.ray, s.origin = onward, si.p
    s.throughput = s.throughput * sample.weight
    # How a path ends is no part of what it brings on average, and has no derivative.
    gain = dr.max(dr.detach(s.throughput))
    if s.eta is not None:
        s.eta = s.eta * dr.detach(sample.eta)
        gain *= s.eta * s.eta
    s.shown |= goes_on & ~sample.null
    s.pdf, s.delta = sample.pdf, sample.delta
    s.depth = dr.select(si.valid, s.depth + 1, s.depth)
    if direct is not None:
        assert shadow_ray is not None
        lit &= ~tracing.blocked(shadow_ray, lit)
        s.radiance = dr.select(lit, s.radiance + direct, s.radiance)

    at_risk = s.depth >= limits.rr_depth
    if tracing.follows_black:
        black = (gain <= 0) & (sample.pdf > 0)
        at_risk |= black & (s.depth >= _BLACK_DEPTH)
        gain = dr.select(black, 0.5, gain)
    survival = dr.fmin(gain, t.Float(0.95))
    survives = sampler.next_1d() < survival
    s.throughput = dr.select(at_risk, s.throughput * dr.rcp(dr.select(survival > 0, survival, 1)), s.throughput)
    s.active = goes_on & (~at_risk | survives) & (gain > 0)
    return s
