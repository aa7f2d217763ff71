"""Integrators: what is computed along each ray."""
