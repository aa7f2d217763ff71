"""Derivatives of integrators."""

from .aov import aov_again
from .direct import direct_again
from .path import LONGEST, moving_parts, path_backward, path_forward
from .what import Replay

__all__ = ["LONGEST", "Replay", "aov_again", "direct_again", "moving_parts", "path_backward", "path_forward"]
