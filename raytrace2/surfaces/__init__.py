"""Surfaces: what a ray can meet, and the geometry where it met it."""
