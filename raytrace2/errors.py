"""The errors that users meet. Each says what is wrong, where (file and line when a file is to blame) and what to do."""

from __future__ import annotations

from dataclasses import dataclass

_LONGEST = 1200


@dataclass(frozen=True)
class Location:
    """A place in a file: ``str()`` gives ``file:line``, or just the file when no line is known."""

    file: str
    line: int | None = None

    def __str__(self) -> str:
        return self.file if self.line is None else f"{self.file}:{self.line}"


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong with an input, in one line: where, what, and the remedy."""

    message: str
    location: Location | None = None
    remedy: str | None = None

    def __str__(self) -> str:
        where = f"{self.location}: " if self.location else ""
        remedy = f" ({self.remedy})" if self.remedy else ""
        text = " ".join(f"{where}{self.message}{remedy}".split())
        text = "".join(c if c.isprintable() else c.encode("unicode_escape", "replace").decode() for c in text)
        # The start says where, the end what to do.
        return text if len(text) <= _LONGEST else f"{text[: _LONGEST // 2]} ... {text[-_LONGEST // 2 :]}"


class RayTraceError(Exception):
    """Base of every error that raytrace2 raises on purpose; the command line turns it into exit status 2."""


class SceneError(RayTraceError, ValueError):
    """A scene that cannot be rendered as written. ``problems`` lists everything found, not just the first."""

    def __init__(self, problems: list[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(str(p) for p in problems))


class FileError(RayTraceError, ValueError):
    """A mesh or image file that cannot be read. ``problem.location`` names the file."""

    def __init__(self, message: str, file: str, line: int | None = None, remedy: str | None = None) -> None:
        self.problem = Problem(message, Location(file, line), remedy)
        super().__init__(str(self.problem))


class GeometryError(RayTraceError, ValueError):
    """Geometry that no structure can hold: indices out of range, NaN or infinite coordinates, wrong shapes."""


class SettingError(RayTraceError, ValueError):
    """A setting (a structure, one of its options, a filter) that does not exist or has no such value."""


class EnvironmentProblem(RayTraceError, RuntimeError):
    """This machine lacks something that is needed (libLLVM, a browser); the message says how to get it."""
