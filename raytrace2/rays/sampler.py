"""Samplers: streams of uniform numbers, reproducible by seed and the same however a render is split into passes."""

from __future__ import annotations

from typing import Any, Protocol

from ..errors import Problem, SceneError
from ..scene.description import Sampler as SamplerDescription
from ..types import Types
from .independent import Independent
from .low_discrepancy import LowDiscrepancy
from .multijitter import MultiJitter
from .stratified import Stratified
from .wavefront import Wavefront


class Sampler(Protocol):
    """A PyTree that can be part of the state of a Dr.Jit loop; numbers are at least 0 and below 1 in either precision.

    ``sample_count`` is the number of samples a pixel, over all passes, that the sampler was made for.
    """

    sample_count: int

    def seed(self, seed: Any, wavefront: Wavefront) -> None:
        """Begin the sequences of the lanes of ``wavefront``; ``seed`` is an int or a UInt of width 1."""

    def next_1d(self, active: Any = True) -> Any:
        """One Float a lane."""

    def next_2d(self, active: Any = True) -> Any:
        """One Array2f a lane."""


def make_sampler(desc: SamplerDescription, types: Types, sample_count: int | None = None) -> Sampler:
    """The sampler of ``desc`` for ``sample_count`` samples a pixel (those of ``desc`` if None).

    Stratified samplers round the count up to one that fills their grid: read ``sample_count`` of the result.
    :class:`SceneError` for a kind that is not there or a count below 1.
    """
    count = desc.sample_count if sample_count is None else sample_count
    if not 1 <= count < 2**31:
        raise _error(f"{count} samples per pixel cannot be taken", "choose a positive sample count")
    if desc.kind == "independent":
        return Independent(types.precision, count, desc.seed)
    if desc.kind == "stratified":
        return Stratified(types.precision, Stratified.round_sample_count(count), desc.seed, desc.jitter)
    if desc.kind == "multijitter":
        return MultiJitter(types.precision, MultiJitter.round_sample_count(count), desc.seed, desc.jitter)
    if desc.kind == "ldsampler":
        return LowDiscrepancy(types.precision, count, desc.seed)
    raise _error(f"no sampler of kind {desc.kind!r}", "use independent, stratified, multijitter or ldsampler")


def _error(message: str, remedy: str) -> SceneError:
    return SceneError([Problem(message, remedy=remedy)])
