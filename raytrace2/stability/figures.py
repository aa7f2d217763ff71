"""The rows of the scoreboard: what each measures, and what would be right."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from . import accuracy, leaks, scales, spawned, times
from .sweep import Counts, Record
from .tracers import Tracer

Measure = Callable[[Sequence[Tracer], str, Counts], dict[str, Record]]


@dataclass(frozen=True)
class Figure:
    """``title`` of the row; ``measure``; ``wanted`` as text; ``limit``: the largest good value in each precision;
    ``others``: whether Mitsuba takes part."""

    key: str
    title: str
    measure: Measure
    wanted: str
    limit: tuple[float, float] = (0.0, 0.0)
    others: bool = True

    def good(self, value: float, precision: str) -> bool:
        """Whether a value is as wanted."""
        return value <= self.limit[precision == "float64"]


FIGURES = (
    Figure("vertex_outside", "leaks at vertices, ico from outside", leaks.vertices_outside, "0"),
    Figure("vertex_inside", "leaks at vertices, spiky from inside", leaks.vertices_inside, "0"),
    Figure("edge_inside", "leaks at edges, spiky from inside", leaks.edges_inside, "0"),
    Figure("edge_outside", "leaks at edges, ico from outside", leaks.edges_outside, "0"),
    Figure("translated", "leaks of random rays at translation 10^6", leaks.translated, "0"),
    Figure("scales", "t / 2^k with other bits than at k = 0, k from -60 to 60", scales.sweep, "0"),
    Figure("spawned_tiny", "spawned rays at scale 1e-5: inward misses", spawned.tiny, "0"),
    Figure("spawned_far", "spawned rays at translation 10^6: inward misses", spawned.far, "0"),
    Figure("gaps", "smallest resolved gap, in radii, R = 1e-3", spawned.gaps, "1e-6", (1.01e-6, 1.01e-6)),
    Figure("mesh_t", "worst relative error of t, ico", accuracy.mesh_t, "1.2e-7; 2.3e-16", (1.2e-7, 2.3e-16)),
    Figure("ground", "ground sphere R = 1e6, eye 1 above: relative error of t", accuracy.ground, "1e-6", (1e-6, 1e-6)),
    Figure("far_sphere", "sphere at D/r = 10^6: error of normals, degrees", accuracy.far_sphere, "0.01", (0.01, 0.01)),
    Figure("ended", "occluded against intersect at tmax < 0, of 1000", accuracy.ended, "0"),
    Figure("times", "slowest extreme case / benign case, time of a ray", times.extremes, "10", (10.0, 10.0), False),
)  # fmt: skip


def figure(key: str) -> Figure:
    """The figure of that key."""
    return next(f for f in FIGURES if f.key == key)
