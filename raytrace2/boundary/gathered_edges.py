"""Where what gives light to a surface ends, as the surface sees it: for light that is found by sampling materials.

A direction that a material chooses is held fixed in the world, wherever the surface goes. So what moves are the curves
as seen from the point that a path is at, which itself moves; and what jumps is all light along such directions, with
the weight that multiple importance sampling gives it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..integrators.emission import met_emission
from ..integrators.path import Limits, bounce, start
from ..integrators.tracing import StructureTracing
from ..job import Job
from ..lights.area_mesh import MeshLights
from ..materials.sample import BsdfSample
from ..rays.ray import Ray
from ..types import types as make_types
from . import film_side
from .choose import Choice
from .crossings import Crossings, twice
from .curves import Curves
from .round_curves import Eye
from .walk import Walk, per_sample, walk

#: Of so many points of curves one is taken, by what it may bring.
_CANDIDATES = 16


@dataclass(frozen=True, eq=False)
class Gathering:
    """``curves``, drawn by ``choice``, as seen from the surfaces for which ``receives`` (UInt buffer) is not 0, or from
    all if None."""

    curves: Curves
    choice: Choice
    receives: Any


def gathers(job: Job, bounces: int) -> bool:
    """Whether light is found by sampling materials, ``bounces`` from what the camera sees."""
    scene, settings = job.traced, job.settings
    shining = scene.lights.has_area or scene.lights.has_environment
    if not scene.materials.has_smooth_any:
        return False
    if settings.kind == "direct":
        return bool(settings.bsdf_samples and shining and not bounces)
    scatters = settings.max_depth - bounces
    if settings.max_depth < 0 or scatters > 2:
        return bool(scene.lights.count)
    return bool(shining and scatters == 2)


def gathered_edges(
    job: Job, gathering: Gathering, bounces: int, seed: Any, count: int, first: int, total: int
) -> Crossings:
    """The samples ``first`` to ``first + count`` of ``total``, drawn from ``seed``: what is seen from the surfaces that
    paths get to after so many ``bounces``."""
    scene, t = job.traced, job.traced.types
    structure, curves = scene.structure, gathering.curves
    here, sampler = walk(job, bounces, seed, count, first, total)
    si, active = here.meeting.si, here.active
    if gathering.receives is not None:
        active &= dr.gather(t.UInt, gathering.receives, si.surface, active) != 0
    eye = Eye(dr.detach(si.p), False)
    creases = _creases_show(job, bounces)
    index, s, weight = _gathered_curve(job, gathering, here, creases, eye, sampler, active)
    dr.eval(active, index, s, weight, sampler.rng)

    point = curves.at(index, s, eye)
    active &= (weight > 0) & (point.bend > 0 if creases else point.hides)
    offset = point.x - si.p
    square = dr.squared_norm(offset)
    active &= square > 0
    square = dr.select(active, square, 1)
    # Towards the other side, and as long as the curve is in directions, over the distance.
    across = dr.cross(offset, point.along) * (dr.rsqrt(square) / square)
    size = dr.norm(across)
    active &= size > 0
    step = across / dr.select(size > 0, size, 1)
    reach = film_side.reach(point.x, si.p) + si.p_error * (1 / t.epsilon)
    step = step * (reach * (film_side.SHADOW_CLEARANCE * t.epsilon))
    if not scene.materials.has_null:
        way = si.spawn_ray(offset)
        active &= ~structure.occluded(Ray.of(way.o, way.d, 0, 1 - film_side.NEAR), active)
    across = across * (weight * per_sample(job, total))
    dr.eval(active, across, step)

    # What comes from either side, by the same numbers.
    lanes = dr.arange(t.UInt, count)
    jump = t.Array3f(0)
    for sign in (-1, 1):
        jump -= _gathered(job, here, bounces, point.x + step * sign, twice(sampler, lanes), active) * sign
    jump = jump * here.throughput
    dr.eval(jump)

    def position() -> Any:
        seen = structure.interact(here.moving(), here.hit).p
        return curves.at(index, s, Eye(seen, False)).x - seen

    return Crossings(job.view.film, (here.at.x, here.at.y), jump, across, active, position)


def _creases_show(job: Job, bounces: int) -> bool:
    """Whether light jumps where a surface only bends: reflected light, and the weight of light that emits."""
    settings, area = job.settings, job.traced.lights.area
    if area is not None and any(isinstance(table, MeshLights) for table, _, _ in area.kinds):
        return True
    return settings.kind == "path" and (settings.max_depth < 0 or settings.max_depth - bounces > 2)


def _gathered_curve(
    job: Job, gathering: Gathering, here: Walk, creases: bool, eye: Eye, sampler: Any, active: Any
) -> tuple[Any, Any, Any]:
    """A curve that ends a surface (or, of ``creases``, bends one) as seen from ``eye``, where on it, and the inverse of
    its density (0 for none): one of some candidates, by how much of a bright world it would move (resampling: Talbot,
    Cline and Egbert, EGSR 2005)."""
    t, curves = gathering.curves.types, gathering.curves
    materials = job.traced.materials

    def step(i: Any, sum: Any, index: Any, s: Any, inverse: Any, sampler: Any) -> tuple[Any, ...]:
        si = here.meeting.inside(True).si
        number, probability, rest = gathering.choice.draw(make_types("float64").Float(sampler.next_1d()))
        point = curves.at(number, rest, eye, active)
        offset = point.x - eye.at
        square = dr.squared_norm(offset)
        good = active & (point.bend > 0 if creases else point.hides) & (probability > 0) & (square > 0)
        good &= curves.outlined(number, active) != si.surface
        square = dr.select(good, square, 1)
        value, _ = materials.eval_pdf(si, here.material, si.to_local(offset * dr.rsqrt(square)), good)
        # What moves is the curve in directions, whose speed is that in space over the distance.
        size = dr.norm(dr.cross(offset, point.along)) / square * dr.rsqrt(square)
        worth = dr.max(value) * size * (point.bend if creases else 1)
        share = dr.select(good & dr.isfinite(worth), worth / dr.select(good, probability, 1), 0)
        sum = sum + share
        taken = sampler.next_1d() * sum < share
        return (
            i + 1, sum, dr.select(taken, number, index), dr.select(taken, rest, s),
            dr.select(taken, dr.rcp(worth), inverse), sampler,
        )  # fmt: skip

    width = dr.width(eye.at)
    none, zero = dr.zeros(t.UInt, width), dr.zeros(t.Float, width)
    state = (none, zero, none + 0, zero + 0, zero + 0, sampler)
    found = dr.while_loop(state, lambda i, *_: i < _CANDIDATES, step, label="gathered curve")
    _, sum, index, s, inverse, done = found
    sampler.rng = done.rng
    share = gathering.curves.share(index, active)
    return index, s, dr.select(sum > 0, sum * inverse * share / _CANDIDATES, 0)


def _gathered(job: Job, here: Walk, bounces: int, target: Any, sampler: Any, active: Any) -> Any:
    """The light (Array3f) that comes from the direction of ``target``, as far as sampling the material finds it, and
    goes on the way that ``here`` came."""
    view, scene, settings, t = job.view, job.traced, job.settings, job.traced.types
    meeting, si, differential = here.meeting, here.meeting.si, here.differential
    d = dr.normalize(target - si.p)
    wo = si.to_local(d)
    value, pdf = scene.materials.eval_pdf(si, here.material, wo, active)
    active = active & (pdf > 0) & (dr.max(value) > 0)
    onward = si.spawn_ray(d)
    left = None
    if differential is not None:
        no = t.Bool(False)
        sample = BsdfSample(wo, value / dr.select(active, pdf, 1), pdf, t.Float(1), no, no)
        left = dr.detach(view.differentials.leave(meeting, sample, onward, differential))
        onward = dr.detach(onward)
    if settings.kind == "direct":
        met = view.differentials.meet(scene.structure, onward, left, scene.structure.intersect(onward, active))
        if scene.draws_texels:
            met = met.drawing(sampler.next_2d())
        alone = t.Bool(settings.emitter_samples == 0)
        density = pdf * (settings.bsdf_samples / max(settings.emitter_samples, 1))
        return dr.select(active, value * met_emission(scene, si.p, onward, met.si, density, alone, active, left), 0)
    state = start(scene, settings, onward, active, left)
    zero = dr.zeros(t.Float, len(onward))
    state.throughput, state.origin = state.throughput * value, state.origin + si.p
    state.pdf, state.delta, state.depth = zero + pdf, zero > 1, state.depth + (bounces + 1)
    state.shown = zero < 1
    limits, tracing = Limits.of(scene, settings), StructureTracing(scene)

    def step(state: Any, sampler: Any) -> tuple[Any, Any]:
        return bounce(scene, limits, state, sampler, view.differentials, tracing), sampler

    state, _ = dr.while_loop((state, sampler), lambda s, _: s.active, step, label="gathered light")
    return dr.select(active, state.radiance, 0)
