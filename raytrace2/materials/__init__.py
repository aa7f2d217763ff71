"""Materials of a scene in structure-of-arrays tables, met by index inside kernels."""

from .sample import BsdfSample
from .table import MaterialTable

__all__ = ["BsdfSample", "MaterialTable"]
