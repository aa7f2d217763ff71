"""Where shadows end on surfaces that scatter their light on to other ones, as these see it."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..job import Job
from ..rays.ray import Ray
from . import film_side
from .casting import Casting, cast, material_share
from .crossings import Crossings
from .walk import Walk, per_sample, walk


def scattered_shadows(
    job: Job, casting: Casting, bounces: int, seed: Any, count: int, first: int, total: int
) -> Crossings:
    """The samples ``first`` to ``first + count`` of ``total``, drawn from ``seed``: what is seen from the surfaces that
    paths get to after so many ``bounces``."""
    t, structure = job.traced.types, job.traced.structure
    here, sampler = walk(job, bounces, seed, count, first, total)
    shadow = cast(job, casting, sampler, count, first, total)
    si, far = here.meeting.si, shadow.si
    active = here.active & shadow.active

    # How the shadow's edge runs in the directions from here.
    offset = far.p - si.p
    square = dr.squared_norm(offset)
    active &= square > 0
    square = dr.select(active, square, 1)
    distance = dr.sqrt(square)
    across = dr.cross(offset, shadow.along) / (square * distance)
    size = dr.norm(across)
    tilt = dr.dot(far.n, offset)
    active &= (size > 0) & (tilt != 0)
    way = across / dr.select(size > 0, size, 1)
    on_surface = way - offset * (dr.dot(far.n, way) / dr.select(active, tilt, 1))
    reach = dr.fmax(film_side.reach(si.p), shadow.reach) + si.p_error * (1 / t.epsilon)
    length = film_side.clear_of_rounding(on_surface, shadow.plane, reach, film_side.SHADOW_CLEARANCE * t.epsilon)
    active &= length < film_side.NEAR * distance
    between = si.spawn_ray(offset)
    active &= ~structure.occluded(Ray.of(between.o, between.d, 0, 1 - film_side.NEAR), active)
    held = si.spawn_ray(offset / distance)
    hit = structure.intersect(held, active)
    active &= hit.valid & (dr.abs(hit.t - distance) < distance * film_side.NEAR)
    step = way * length
    dr.eval(active, step, across, held, hit)

    jump = t.Array3f(0)
    for sign in (-1, 1):
        jump -= _scattered(job, casting, here, shadow.u, far.p + step * sign, active) * sign
    share = casting.curves.share(shadow.index) * per_sample(job, total)
    across = across * (share / dr.select(active, shadow.chance, 1))
    jump = jump * here.throughput
    dr.eval(jump)

    def position() -> Any:
        seen = structure.interact(here.moving(), here.hit).p
        # Where light is sampled by how it is seen, it is seen from where the direction from here is held.
        lit = structure.interact(Ray.of(dr.replace_grad(held.o, seen), held.d), hit).p
        return shadow.moved(structure, lit) - seen

    return Crossings(job.view.film, (here.at.x, here.at.y), jump, across, active, position)


def _scattered(job: Job, casting: Casting, here: Walk, u: Any, target: Any, active: Any) -> Any:
    """The light (Array3f) of the point ``u`` of a light that comes by way of ``target`` and goes on the way that
    ``here`` came."""
    scene = job.traced
    si = here.meeting.si
    d = dr.normalize(target - si.p)
    value, pdf = scene.materials.eval_pdf(si, here.material, si.to_local(d), active)
    active = active & (dr.max(value) > 0) & (pdf > 0)
    onward = si.spawn_ray(d)
    beyond = scene.structure.interact(onward, scene.structure.intersect(onward, active))
    active &= beyond.valid
    material = scene.material(beyond, active)
    return value * casting.kind.light(beyond, u, material, material_share(job), active)
