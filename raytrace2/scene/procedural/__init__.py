"""The scenes of the field, made by formula: the same for the same name, size and seed on every machine."""

from __future__ import annotations

from .bumpy import bumpy_sphere
from .catalog import make, names
from .landscapes import terrain
from .scene import ProceduralScene, View

__all__ = ["ProceduralScene", "View", "bumpy_sphere", "make", "names", "terrain"]
