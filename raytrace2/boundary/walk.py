"""Paths from the camera to the surface at which edges are looked at."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..film import Film
from ..integrators.path import Limits, bounce, start
from ..integrators.replay.memory import Player, Recorder
from ..integrators.replay.path import Entry
from ..integrators.tracing import StructureTracing
from ..job import Job
from ..rays.differentials import Meeting
from ..rays.ray import Ray
from ..surfaces.hit import Hit
from ..types import types as make_types
from .crossings import random_numbers


@dataclass(frozen=True, eq=False)
class Walk:
    """Where a path from the film position ``at`` (Array2f) is after some bounces: the last ray's ``hit`` and
    ``meeting``, the ``material`` there, the ``throughput`` (Array3f) up to there and the ray's ``differential``, where
    ``active``; all without derivatives. ``moving`` gives that ray with derivatives, for the same random numbers, along
    directions that stay where smooth lobes sent them."""

    at: Any
    hit: Hit
    meeting: Meeting
    material: Any
    throughput: Any
    differential: Any
    active: Any
    moving: Callable[[], Ray]


def walk(job: Job, bounces: int, seed: Any, count: int, first: int, total: int) -> tuple[Walk, Any]:
    """Paths spread over all of the film, the lanes ``first`` to ``first + count`` of ``total``, to surfaces that
    scatter more than in single directions; and random numbers to go on with."""
    view, scene, t = job.view, job.traced, job.traced.types
    camera, film = view.camera, view.film
    sampler = random_numbers(job, seed, count, first)
    at = _position(job, film, sampler, count, first, total)
    aperture = sampler.next_2d() if camera.needs_aperture_sample else None
    dr.eval(at, aperture, sampler.rng)

    limits, tracing = Limits.of(scene, job.settings), StructureTracing(scene)
    ray, differential = view.differentials.start(camera, at, aperture)
    state, entries = start(scene, job.settings, ray, True, differential), []
    for _ in range(bounces):
        recorder = Recorder(tracing, sampler, view.differentials)
        entries.append(Entry.of(state, recorder.memory, True))
        state = dr.detach(bounce(scene, limits, state, recorder, recorder, recorder))
        dr.eval(entries[-1], state.ray, state.throughput, state.active, state.differential, sampler.rng)

    active = t.Bool(state.active)
    if bounces:
        active &= dr.max(state.throughput) > 0
    hidden = t.Bool(True) if job.settings.hide_emitters and not bounces else None
    hit = tracing.closest(state.ray, active, hidden)
    dr.eval(hit)
    meeting = view.differentials.meet(scene.structure, state.ray, state.differential, hit)
    if scene.draws_texels:
        meeting = meeting.drawing(sampler.next_2d())
    active &= meeting.si.valid
    material = scene.material(meeting.si, active)
    active &= scene.materials.has_smooth(material, active)

    def moving() -> Ray:
        ray = camera.sample_ray(at, aperture)
        for k, entry in enumerate(entries):
            player, again = Player(entry.memory, None, True), entry.state(t.UInt(k))
            again.ray = Ray.of(ray.o, ray.d)
            ray = bounce(scene, limits, again, player, player, player).ray
        return ray

    return Walk(at, hit, meeting, material, state.throughput, state.differential, active, moving), sampler


def per_sample(job: Job, total: int) -> Any:
    """What each of ``total`` paths counts for in the film's sums."""
    return dr.opaque(job.traced.types.Float, job.sampler.sample_count * job.view.film.pixel_count / total)


def _position(job: Job, film: Film, sampler: Any, count: int, first: int, total: int) -> Any:
    t, wide = job.traced.types, make_types("float64").Float
    lane = dr.arange(t.UInt, count) + dr.opaque(t.UInt, first)
    place = (wide(lane) + wide(sampler.next_1d())) * dr.opaque(wide, film.pixel_count / total)
    pixel = dr.minimum(t.UInt(place), dr.opaque(t.UInt, film.pixel_count - 1))
    offset = sampler.next_2d()
    return film.position(pixel, t.Array2f(0.5, 0.5) if job.filtering.centred else offset)
