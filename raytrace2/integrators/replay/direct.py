"""Derivatives of direct illumination: it is done again, from what a first time was told, with derivatives attached."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ...rays.differentials import Differentials
from ...rays.ray import Ray
from ...scene.description import Integrator
from ...scene.traced import TracedScene
from ..direct import direct
from ..tracing import StructureTracing
from .memory import Player, Recorder
from .what import Replay


def direct_again(
    scene: TracedScene,
    settings: Integrator,
    sampler: Any,
    ray: Ray,
    moving: Ray,
    replay: Replay,
    differentials: Differentials,
    differential: Any,
    moving_differential: Any,
) -> Any:
    """The radiance (Array3f) along each ray with derivatives attached: by ``replay.values``, and by ``moving`` and its
    differential, which are ``ray`` and ``differential`` with derivatives."""
    with dr.suspend_grad(replay.values):
        recorder = Recorder(StructureTracing(scene), sampler, differentials)
        direct(
            scene, settings, recorder, ray, differentials=recorder, differential=differential, tracing=recorder
        )  # fmt: skip
    player = Player(recorder.memory, replay.through, replay.holds)
    state = differential if replay.through is None else moving_differential
    return direct(scene, settings, player, moving, differentials=player, differential=state, tracing=player)
