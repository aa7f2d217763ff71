"""What is differentiated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...rays.differentials import Differentials


@dataclass(frozen=True)
class Replay:
    """``values``: the arrays that kernels read and that carry derivatives. ``moves``: whether rays depend on them.
    ``through``: the differentials by which footprints do (None: footprints are taken as they are). ``holds``:
    directions that smooth lobes chose do not move with surfaces, which is how moving edges are told."""

    values: list[Any]
    moves: bool
    through: Differentials | None
    holds: bool = False
