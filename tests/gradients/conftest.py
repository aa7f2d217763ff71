"""Lets the tests of this folder import their helpers, and raytrace2 settle libLLVM before anything imports drjit."""

import sys
from pathlib import Path

import raytrace2  # noqa: F401

sys.path.insert(0, str(Path(__file__).parent))
