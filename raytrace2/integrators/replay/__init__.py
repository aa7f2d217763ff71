"""Derivatives of integrators."""

from .direct import direct_again
from .path import LONGEST, moving_parts, path_backward, path_forward
from .what import Replay

__all__ = ["LONGEST", "Replay", "direct_again", "moving_parts", "path_backward", "path_forward"]
