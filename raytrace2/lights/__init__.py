"""Lights: tables built from scene descriptions, sampled and evaluated inside the integrators' loops."""

from .sample import LightSample
from .table import NO_LIGHT, LightTable

__all__ = ["NO_LIGHT", "LightSample", "LightTable"]
