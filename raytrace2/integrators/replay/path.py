"""Derivatives of path tracing by replay: with memory that grows neither with the length of paths nor with their number.

A first loop traces the paths as they were rendered, and writes down the few numbers that each bounce was told from
outside. A second loop, of the same kernel, goes back from the last bounce to the first: each bounce is done again from
its memory, without a traversal, with derivatives attached, and takes the adjoint of the state that it left behind to
that of the state it began with (what Vicini, Speierer and Jakob, "Path replay backpropagation", SIGGRAPH 2021, do for
light alone; here rays, densities and footprints have adjoints too, so that every derivative of the sampled path is
there). Forward mode does both in one loop.

Derivatives are those of the program at fixed random numbers: what depends on a choice that they make (which lobe of
glass, whether a mask holds) is weighted by the derivative of the choice's probability, and Russian roulette has none.
That visibility changes is not seen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr

from ...rays.differentials import Differentials
from ...rays.ray import Ray
from ...scene.description import Integrator
from ...scene.traced import TracedScene
from ..path import Limits, PathState, bounce, start
from ..tracing import StructureTracing
from .memory import Memory, Nothing, Player, Recorder
from .tape import Tape
from .what import Replay

#: The longest path that is remembered where the integrator has no bound of its own.
LONGEST = 256


@dataclass
class Entry:
    """The state of a path before a bounce, as far as the bounce reads it, and the bounce's memory."""

    o: Any
    d: Any
    throughput: Any
    eta: Any
    origin: Any
    pdf: Any
    delta: Any
    differential: Any
    memory: Any

    @staticmethod
    def of(s: PathState, memory: Memory, with_differential: bool) -> Entry:
        """That of ``s``."""
        differential = s.differential if with_differential else None
        return Entry(s.ray.o, s.ray.d, s.throughput, s.eta, s.origin, s.pdf, s.delta, differential, memory)

    def state(self, depth: Any) -> PathState:
        """The state again, ``depth`` bounces from the camera, with no light yet."""
        zero = dr.zeros(type(self.throughput), dr.width(self.throughput))
        on = dr.full(type(self.delta), True, dr.width(self.throughput))
        return PathState(
            Ray.of(self.o, self.d), self.throughput, zero, self.eta, depth, self.origin, self.pdf, self.delta, on, on,
            self.differential,
        )  # fmt: skip


def path_backward(
    scene: TracedScene,
    settings: Integrator,
    sampler: Any,
    ray: Ray,
    adjoint: Any,
    replay: Replay,
    differentials: Differentials,
    differential: Any,
) -> tuple[Any, Any]:
    """Adds to the gradients of ``replay.values`` those of the radiance along each ray times ``adjoint`` (Array3f).

    Returns the adjoints of the state that paths begin in (those parts of it that the replay follows, as
    :func:`moving_parts` orders them), and how many paths were longer than what is remembered (UInt, on the device).
    """
    t, limits, tracing = scene.types, Limits.of(scene, settings), StructureTracing(scene)
    # Paths of no depth have a first bounce, too, which counts for nothing.
    length = min(max(settings.max_depth, 1), LONGEST) if settings.max_depth >= 0 else LONGEST
    state = start(scene, settings, ray, True, differential)
    keeps = replay.through is not None or _filters_light(scene)
    with dr.suspend_grad(replay.values):
        like = _blank(scene, limits, state, differentials, keeps)
        # One more, for what there is no room for.
        tape = Tape(like, length + 1)

        def record(state: PathState, sampler: Any, tape: Tape, count: Any) -> tuple[PathState, Any, Tape, Any]:
            recorder = Recorder(tracing, sampler, differentials)
            before = Entry.of(state, recorder.memory, keeps)
            state = bounce(scene, limits, state, recorder, recorder, recorder)
            tape.write(dr.select(count < length, count, length), before)
            return state, sampler, tape, count + 1

        count = dr.zeros(t.UInt, len(ray))
        state, _, tape, count = dr.while_loop(
            (state, sampler, tape, count), lambda s, *_: s.active, record, label="path, forth"
        )
    too_long = dr.zeros(t.UInt, 1)
    dr.scatter_add(too_long, t.UInt(1), t.UInt(0), count > length)
    adjoint = dr.select(state.shown & (settings.max_depth != 0), adjoint, 0)
    following = [dr.zeros(type(leaf), len(ray)) for leaf in moving_parts(like, replay)]

    def back(count: Any, following: list[Any]) -> tuple[Any, list[Any]]:
        count = count - 1
        entry = tape.read(count, like)
        parts = moving_parts(entry, replay)
        dr.enable_grad(parts)
        player = Player(entry.memory, replay.through, replay.holds)
        after = bounce(scene, limits, entry.state(count), player, player, player)
        radiance, left = after.radiance, moving_parts(after, replay)
        total = dr.dot(adjoint, radiance)
        for a, x in zip(following, left, strict=True):
            total = total + (dr.dot(a, x) if dr.depth_v(x) > 1 else a * x)
        if dr.grad_enabled(total):
            dr.backward_from(total)
        return count, [_finite(dr.grad(part)) for part in parts]

    state_after = dr.select(count < length, count, length), following
    _, following = dr.while_loop(state_after, lambda count, _: count > 0, back, label="path, back")
    return following, too_long


def path_forward(
    scene: TracedScene,
    settings: Integrator,
    sampler: Any,
    ray: Ray,
    moved: list[Any],
    replay: Replay,
    differentials: Differentials,
    differential: Any,
) -> Any:
    """How the radiance (Array3f) along each ray changes for the tangents of ``replay.values`` and ``moved``, those of
    the ray and its differential as :func:`moving_parts` orders them (without the throughput: it begins at one)."""
    limits, tracing = Limits.of(scene, settings), StructureTracing(scene)
    state = start(scene, settings, ray, True, differential)
    width = len(ray)
    tangents = [dr.zeros(type(part), width) for part in moving_parts(state, replay)]
    if replay.moves:
        tangents[1:3] = moved[:2]
        tangents[5:] = moved[2:]

    def step(state: PathState, sampler: Any, tangents: list[Any], change: Any) -> tuple[Any, ...]:
        recorder = Recorder(tracing, sampler, differentials)
        before = Entry.of(state, recorder.memory, True)
        depth = state.depth
        with dr.suspend_grad(replay.values):
            state = bounce(scene, limits, state, recorder, recorder, recorder)
        entry = dr.detach(before)
        parts = moving_parts(entry, replay)
        dr.enable_grad(parts)
        for part, tangent in zip(parts, tangents, strict=True):
            dr.set_grad(part, tangent)
        player = Player(entry.memory, replay.through, replay.holds)
        again = entry.state(depth)
        after = bounce(scene, limits, again, player, player, player)
        ends = [-x for x in (after.radiance, *moving_parts(after, replay))]
        moving = [x for x in ends if dr.grad_enabled(x)]
        if moving:
            dr.forward_to(moving, flags=dr.ADFlag.ClearEdges | dr.ADFlag.ClearInterior)
        found = [_finite(-dr.grad(x)) + dr.zeros(type(x), 1) for x in ends]
        return state, sampler, found[1:], change + found[0]

    zero = dr.zeros(scene.types.Array3f, width)
    state, _, _, change = dr.while_loop(
        (state, sampler, tangents, zero), lambda s, *_: s.active, step, label="path, tangents"
    )
    return dr.select(state.shown & (settings.max_depth != 0), change, 0)


def moving_parts(state: Entry | PathState, replay: Replay) -> list[Any]:
    """What of a state has derivatives: what the path may still bring; and, where rays move, the ray, the point that it
    came from, the density that chose it, and its differential if footprints move too."""
    if not replay.moves:
        return [state.throughput]
    o, d = (state.ray.o, state.ray.d) if isinstance(state, PathState) else (state.o, state.d)
    parts = [state.throughput, o, d, state.origin, state.pdf]
    if replay.through is not None:
        s = state.differential
        parts += [s.o_dx, s.d_dx, s.o_dy, s.d_dy]
    return parts


def _blank(
    scene: TracedScene, limits: Limits, state: PathState, differentials: Differentials, with_differential: bool
) -> Entry:
    """An entry of no path, to tell what entries are made of."""
    nothing = Nothing(scene.types)
    recorder = Recorder(nothing, nothing, differentials)
    entry = Entry.of(state, recorder.memory, with_differential)
    bounce(scene, limits, replace(state), recorder, recorder, recorder)
    return entry


def _filters_light(scene: TracedScene) -> bool:
    return bool(scene.lights.filters_environment)


def _finite(x: Any) -> Any:
    return dr.select(dr.isfinite(x), x, 0)
