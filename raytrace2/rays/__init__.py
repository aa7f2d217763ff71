"""Rays, cameras and samplers."""
