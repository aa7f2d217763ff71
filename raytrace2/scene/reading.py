"""What all readers of nodes share: the list of problems found so far, and typed access to a node's properties."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ..errors import FileError, Problem
from .defaults import DEFAULTS
from .nodes import DistortedTransform, Node, Value
from .xml_check import is_url

T = TypeVar("T")


@dataclass
class Reading:
    """One reading of a scene. Readers report to ``problems`` and go on, so that all of them are found at once.

    ``results`` remembers what a node was read as: a node that is referred to twice becomes one object.
    """

    resolve: Callable[[str], str]
    problems: list[Problem] = field(default_factory=list)
    results: dict[int, Any] = field(default_factory=dict)
    files: dict[Any, Any] = field(default_factory=dict)

    def refuse(self, node: Node, message: str, remedy: str | None = None) -> None:
        """Reports that ``node`` cannot be rendered as written."""
        problem = Problem(f"plugin '{node.plugin}': {message}", node.location, remedy)
        if problem not in self.problems:
            self.problems.append(problem)

    def unsupported(self, node: Node, supported: Iterable[str]) -> None:
        """Reports that ``node`` is of a kind that cannot be rendered at all."""
        names = ", ".join(sorted(supported))
        problem = Problem(
            f"plugin '{node.plugin}' ({node.kind}) is not supported", node.location, f"supported are: {names}"
        )
        if problem not in self.problems:
            self.problems.append(problem)

    def once(self, node: Node, read: Callable[[], Any]) -> Any:
        """The result of ``read()`` the first time, and the same object from then on."""
        if id(node) not in self.results:
            self.results[id(node)] = read()
        return self.results[id(node)]

    def file(self, node: Node, name: str) -> str | None:
        """The path of the file that ``node`` calls ``name``, or None (and a problem) if there is none."""
        if is_url(name):
            self.refuse(node, f"'{name}' is an address, not a file", "download it and name the file")
            return None
        try:
            path = self.resolve(name)
            found = bool(name) and Path(path).is_file()
        except (OSError, ValueError):  # a name that is too long, or no text
            found = False
        if not found:
            self.refuse(node, f"file '{name}' not found", "check the path, or name its folder with <path value=.../>")
            return None
        return path

    def attempt(self, node: Node, load: Callable[[], T]) -> T | None:
        """``load()``, or None after its ``FileError`` or ``ValueError`` has become a problem of ``node``."""
        try:
            return load()
        except FileError as error:
            problem = error.problem
            where = f"{problem.location}: " if problem.location else ""
            self.refuse(node, f"{where}{problem.message}", problem.remedy)
        except ValueError as error:
            self.refuse(node, str(error))
        return None


class PropertyReader:
    """Typed properties of one node with defaults filled in; :meth:`finish` reports those that nobody asked for."""

    def __init__(self, node: Node, reading: Reading) -> None:
        self.node = node
        self.reading = reading
        self._defaults: Mapping[str, Any] = DEFAULTS.get(node.plugin, {})
        self._asked: set[str] = set()

    def has(self, name: str) -> bool:
        """Whether the property or child ``name`` is written in the scene."""
        return name in self.node.properties or any(key == name for key, _ in self.node.children)

    def ignore(self, *names: str) -> None:
        """Accepts properties that shape no image."""
        self._asked.update(names)

    def default(self, name: str) -> Any:
        """The default of ``name`` in the table, or None."""
        return self._defaults.get(name)

    def raw(self, name: str) -> Value | None:
        """The value as parsed, or None if it is not written."""
        self._asked.add(name)
        return self.node.properties.get(name)

    def number(
        self, name: str, *, above: float = -math.inf, least: float = -math.inf, most: float = math.inf,
        default: float | None = None,
    ) -> float:  # fmt: skip
        """A finite float in (above, inf) and [least, most]."""
        value = self._value(name, default)
        if isinstance(value, bool) or not isinstance(value, int | float):
            return self._wrong(name, "a number", value, 1.0)
        value = float(value)
        if not math.isfinite(value):
            return self._wrong(name, "a finite number", value, 1.0)
        if value <= above:
            return self._wrong(name, f"greater than {above:g}", value, 1.0)
        if not least <= value <= most:
            bounds = f"at least {least:g}" if most == math.inf else f"between {least:g} and {most:g}"
            return self._wrong(name, bounds, value, 1.0)
        return value

    def integer(self, name: str, *, least: int, most: int = 2**31 - 1, default: int | None = None) -> int:
        """An int in [least, most]."""
        value = self._value(name, default)
        if isinstance(value, bool) or not isinstance(value, int):
            return self._wrong(name, "an integer", value, max(least, 1))
        if not least <= value <= most:
            return self._wrong(name, f"between {least} and {most}", value, max(least, 1))
        return value

    def boolean(self, name: str) -> bool:
        """True or false."""
        value = self._value(name, None)
        return value if isinstance(value, bool) else self._wrong(name, "true or false", value, False)

    def string(self, name: str, *, default: str | None = None) -> str:
        """Any string."""
        value = self._value(name, default)
        return value if isinstance(value, str) else self._wrong(name, "a string", value, "")

    def choice(self, name: str, choices: tuple[str, ...], *, fold: bool = False) -> str:
        """One of ``choices``; ``fold`` ignores upper and lower case, where Mitsuba does."""
        value = self.string(name)
        value = value.lower() if fold else value
        return value if value in choices else self._wrong(name, "one of " + ", ".join(choices), value, choices[0])

    def vector(self, name: str) -> np.ndarray:
        """Three finite numbers."""
        value = self._value(name, None)
        if isinstance(value, tuple):
            return np.array(value, dtype=np.float64)
        if not isinstance(value, np.ndarray) or value.shape != (3,):
            return self._wrong(name, "three numbers", value, np.zeros(3))
        return value if np.isfinite(value).all() else self._wrong(name, "finite", value.tolist(), np.zeros(3))

    def transform(self, name: str = "to_world", *, invertible: bool = True) -> np.ndarray:
        """A finite affine 4x4 matrix; the identity if it is not written."""
        value = self.raw(name)
        if value is None:
            return np.eye(4)
        if isinstance(value, DistortedTransform):
            remedy = "make x, y, z of <rotate> a unit vector: Mitsuba does not"
            self.reading.refuse(self.node, f"'{name}' rotates about an axis that is not of unit length", remedy)
            return np.eye(4)
        if not isinstance(value, np.ndarray) or value.shape != (4, 4):
            return self._wrong(name, "a transform", value, np.eye(4))
        if not np.isfinite(value).all():
            return self._wrong(name, "finite (is a lookat's target at its origin, or its up along the view?)",
                               None, np.eye(4))  # fmt: skip
        if invertible and is_singular(value[:3, :3]):
            return self._wrong(name, "invertible (is a scale zero?)", None, np.eye(4))
        return value

    def children(self, *kinds: str) -> list[tuple[str, Node]]:
        """The children of these kinds, in order."""
        found = [(name, child) for name, child in self.node.children if child.kind in kinds]
        self._asked.update(name for name, _ in found)
        return found

    def only_child(self, kind: str, *, required: bool = False) -> Node | None:
        """The child of this kind; a problem if there is more than one, or none although it is ``required``."""
        found = self.children(kind)
        if len(found) > 1:
            self.reading.refuse(self.node, f"has {len(found)} children of kind {kind}", "keep one")
        if required and not found:
            self.reading.refuse(self.node, f"needs a child of kind {kind}", f"nest a <{kind}> or a <ref> to one")
        return found[0][1] if found else None

    def child(self, name: str) -> Node | None:
        """The child called ``name``."""
        self._asked.add(name)
        return next((child for key, child in self.node.children if key == name), None)

    def finish(self) -> None:
        """Reports every property and child that was not asked for."""
        known = ", ".join(sorted(n for n in self._asked if not n.startswith("_arg_")))
        for name in self.node.properties:
            if name not in self._asked:
                self.reading.refuse(self.node, f"property '{name}' is not supported", f"supported are: {known}")
        for name, child in self.node.children:
            if name not in self._asked:
                label = "" if name.startswith("_arg_") else f" as '{name}'"
                self.reading.refuse(
                    self.node, f"a {child.kind} ('{child.plugin}'){label} cannot be placed here", "remove it"
                )

    def _value(self, name: str, default: Any) -> Any:
        self._asked.add(name)
        if name in self.node.properties:
            return self.node.properties[name]
        return self._defaults.get(name) if default is None else default

    def _wrong(self, name: str, wanted: str, value: Any, instead: Any) -> Any:
        if value is None and name not in self.node.properties:
            self.reading.refuse(self.node, f"property '{name}' is missing", f"it must be {wanted}")
        else:
            shown = "" if value is None else f", not {value!r}"
            self.reading.refuse(self.node, f"property '{name}' must be {wanted}{shown}")
        return instead


def is_singular(linear: np.ndarray) -> bool:
    """Whether a matrix maps some direction to (nearly) nothing, whatever its overall scale."""
    largest = np.abs(linear).max()
    if not largest > 0.0:
        return True
    singular_values = np.linalg.svd(linear / largest, compute_uv=False)
    return bool(singular_values[-1] <= 1e-12 * singular_values[0])
