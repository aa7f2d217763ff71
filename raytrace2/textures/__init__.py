"""Textures of a scene in structure-of-arrays tables, met by index inside kernels."""

from .parameter import TextureParameter
from .table import TextureTable

__all__ = ["TextureParameter", "TextureTable"]
