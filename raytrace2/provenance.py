"""Provenance: what an image was made from and with, as strings for its header."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from typing import Any

from .render import Rendering
from .scene.scene import Scene


def provenance(scene: Scene, rendering: Rendering, settings: dict[str, Any]) -> dict[str, str]:
    """The scene's file and hash, the ``settings`` of the render, versions of what made it, and seconds."""
    strings = {
        "raytrace2.scene": scene.description.source or "in memory",
        "raytrace2.scene_hash": scene.description.hash,
        "raytrace2.spp": str(rendering.spp),
        "raytrace2.prepare_seconds": f"{rendering.prepare_seconds:.4g}",
        "raytrace2.render_seconds": f"{rendering.seconds:.4g}",
    }
    strings |= {f"raytrace2.settings.{key}": str(value) for key, value in settings.items() if value is not None}
    strings |= {f"raytrace2.version.{name}": _version(name) for name in ("raytrace2", "drjit", "mitsuba", "numpy")}
    return strings


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"
