"""From counts to files: measures, and writes stability.md and stability.png after every row."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from ..files import write_atomically
from .picture import picture
from .scoreboard import Found, Traded, broken_files, run
from .sweep import Counts
from .table import markdown


def measure_and_write(kinds: Sequence[str], counts: Counts, folder: Path, only: Sequence[str] = ()) -> str:
    """Runs the scoreboard; returns the table. Interrupted, the files hold what was done, and the next run goes on."""
    folder.mkdir(parents=True, exist_ok=True)
    broken = broken_files(folder)

    def write(found: Found, traded: Traded) -> None:
        write_atomically(folder / "stability.md", markdown(found, traded, counts, broken).encode())
        stream = io.BytesIO()
        Image.fromarray(picture(found, traded)).save(stream, format="PNG")
        write_atomically(folder / "stability.png", stream.getvalue())

    return markdown(*run(kinds, counts, folder, only, write), counts, broken)
