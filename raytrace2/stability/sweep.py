"""The same rays through everyone who takes part: what goes wrong, rays per second, and whether answers agree."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from ..surfaces.surface import Surface
from .rays import Aimed
from .tracers import Answer, Loaded, Tracer

#: What was found of one who took part: "value", "rays", "rate" (per second), "few" and "all" (digests of answers).
Record = dict[str, Any]

#: Rays that everyone traces, however slow; by their answers all are compared.
FEW = 2048


@dataclass(frozen=True)
class Counts:
    """How much is measured: rays aimed at vertices and edges; random rays; rays of each other figure; the step between
    exponents of scales; faces of the meshes (20 x 4^``levels``); triangles in the same place; the seconds that one
    structure may take for one figure before it gets fewer rays; gaps tried in each decade; the seed."""

    aimed: int = 50_000
    random: int = 50_000
    other: int = 10_000
    scale_step: int = 30
    levels: int = 5
    identical: int = 10_000
    longest: float = 0.25
    gaps_a_decade: int = 1
    seed: int = 0


FULL = Counts(10_000_000, 1_000_000, 100_000, 10, 5, 1_000_000, 2.0, 2)


def load(tracers: Sequence[Tracer], surfaces: Sequence[Surface]) -> dict[str, Loaded]:
    """The surfaces in everyone's own form, by name."""
    return {tracer.name: tracer.load(surfaces) for tracer in tracers}


def traced(
    scenes: dict[str, Loaded],
    source: Iterable[Aimed],
    total: int,
    longest: float,
    judge: Callable[[Aimed, Answer], float],
    combine: Callable[[float, float], float] = lambda a, b: a + b,
    whole: Collection[str] = (),
) -> dict[str, Record]:
    """Sends batches of rays through every scene in turn; ``judge`` says what is wrong with a batch of answers.

    Who would take more than ``longest`` seconds, and is not one of ``whole``, gets the first part of each batch only,
    so that counts stay comparable: the record says how many rays there were.
    """
    records: dict[str, Record] = {}
    digests: dict[str, Any] = {}
    for batch in source:
        for name, scene in scenes.items():
            if name not in records:
                limit = math.inf if name in whole else longest
                records[name], digests[name] = _first(scene, batch, total, limit), hashlib.sha256()
            record = records[name]
            part = batch.first(max(math.ceil(len(batch) * record["share"]), min(FEW, len(batch))))
            answer = scene.closest(part.o, part.d)
            wrong = judge(part, answer)
            record["value"] = wrong if record["value"] is None else combine(record["value"], wrong)
            record["rays"] += len(part)
            record["seconds"] += answer.seconds
            digests[name].update(answer.content())
    for name, record in records.items():
        record["rate"] = record["rays"] / record.pop("seconds")
        record["all"] = digests[name].hexdigest()
    return records


def _first(scene: Loaded, batch: Aimed, total: int, longest: float) -> Record:
    """A record with nothing counted yet: how fast it is, and its answers to the few rays that everyone gets."""
    few = batch.first(FEW)
    digest = digest_of(scene.closest(few.o, few.d))
    return {"value": None, "rays": 0, "seconds": 0.0, "share": share(scene, batch, total, longest), "few": digest}


def share(scene: Loaded, rays: Aimed, total: int, longest: float) -> float:
    """How much of ``total`` rays like these a scene traces in about ``longest`` seconds; 1 if all."""
    seconds, count = 0.0, FEW
    while True:
        part = rays.first(count)
        scene.closest(part.o, part.d)
        seconds = scene.closest(part.o, part.d).seconds / len(part)
        # Few rays do not keep the machine busy: what they take says little of many.
        if count >= 16 * FEW or count >= len(rays) or 16 * seconds * count > longest:
            return min(1.0, longest / (seconds * total))
        count *= 4


def digest_of(*answers: Answer) -> str:
    """Of the bits of answers."""
    digest = hashlib.sha256()
    for answer in answers:
        digest.update(answer.content())
    return digest.hexdigest()


def disagree(records: dict[str, Record]) -> list[str]:
    """Names of those whose answers differ from those of the first of them, on rays that both traced."""
    names = list(records)
    if not names:
        return []
    base = records[names[0]]
    found = []
    for name in names[1:]:
        record = records[name]
        same_rays = record["rays"] == base["rays"]
        if record["few"] != base["few"] or (same_rays and record["all"] != base["all"]):
            found.append(name)
    return found
