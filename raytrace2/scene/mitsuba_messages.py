"""Mitsuba's exceptions, which span lines and name C++ files, as one-line problems with file and line."""

from __future__ import annotations

import re

from ..errors import Location, Problem

_ORIGIN = re.compile(r"\[[\w.]+\.(?:cpp|h):\d+\] ?")
_AT_LINE = re.compile(r"Error while loading (?P<file>.+?) \(line (?P<line>\d+), col \d+\): (?P<message>.*)", re.DOTALL)
_BROKEN = re.compile(
    r'(?:Parsing of XML file "(?P<file>.+?)" failed|XML parsing failed): '
    r"(?P<message>.*?) \(line (?P<line>\d+), col \d+\)",
    re.DOTALL,
)
_IN_FILE = re.compile(r'Error while loading XML file "(?P<file>.+?)": (?P<message>.*)', re.DOTALL)

_REMEDIES = (
    ("undefined parameter", "give it a value with <default> or as a keyword argument"),
    ("unused parameters", "the scene has no such $name: remove the keyword argument"),
    ("missing version attribute", 'write <scene version="3.0.0">'),
    ("maximum include recursion", "a file includes itself, directly or through others"),
    ("not found", "check the path; it is taken relative to the file that names it"),
)


def problem_from_message(text: str, source: str) -> Problem:
    """What the exception text ``text`` of Mitsuba's parser says. ``source`` is the file to blame if it names none.

    Errors inside included files carry one origin per level: the innermost location wins.
    """
    location = Location(source)
    message = text
    for part in (p for p in _ORIGIN.split(text) if p.strip()):
        message = part
        for pattern in (_AT_LINE, _BROKEN, _IN_FILE):
            if match := pattern.search(part):
                found = match.groupdict()
                file = found.get("file") or source
                line = found.get("line")
                location = Location(source if file == "string" else file, int(line) if line else None)
                message = found["message"]
                break
    message = " ".join(message.split())
    lowered = message.lower()
    remedy = next((remedy for key, remedy in _REMEDIES if key in lowered), None)
    return Problem(message, location, remedy)
