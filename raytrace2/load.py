"""Loading: from what users have (a file, XML text, a dict) to a Scene that can be rendered."""

from __future__ import annotations

from os import PathLike, fspath
from typing import Any

from .arguments import shown
from .scene import reader
from .scene.scene import Scene


def load_file(path: str | PathLike[str], **parameters: Any) -> Scene:
    """The scene in the Mitsuba XML file ``path``; ``parameters`` fill in its ``$name``, as in ``mi.load_file``.

    :class:`~raytrace2.SceneError` lists everything that is wrong or not supported, with file and line.
    """
    if not isinstance(path, str | PathLike):
        raise TypeError(f"the path of a scene is a string or a path, not {shown(path)}")
    return Scene(reader.describe_file(path, **parameters), fspath(path), parameters)


def load_string(xml: str, **parameters: Any) -> Scene:
    """The scene in Mitsuba XML text, as ``mi.load_string``."""
    if not isinstance(xml, str):
        raise TypeError(f"the text of a scene is a string, not {shown(xml)}")
    return Scene(reader.describe_string(xml, **parameters), xml, parameters)


def load_dict(scene: dict[str, Any], settings: dict[str, str] | None = None) -> Scene:
    """The scene in a dict as ``mi.load_dict`` takes it. ``settings`` are our own, such as ``{"accel":
    "brute_force"}``."""
    if not isinstance(scene, dict):
        raise TypeError(f"a scene is a dict as mi.load_dict takes it, not {shown(scene)}")
    named = settings is None or (isinstance(settings, dict) and all(isinstance(s, str) for s in settings))
    if not named:
        raise TypeError(f"settings is a dict of names, not {shown(settings)}")
    return Scene(reader.describe_dict(scene, settings), scene)
