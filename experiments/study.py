"""What the studies share: which scenes, which code, and files that are either whole or not there."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import raytrace2
from raytrace2.files import write_atomically

CAPTION_HEIGHT = 14


def scene_files(path: Path, only: Sequence[str]) -> list[Path]:
    """``path`` itself, or every ``*.xml`` directly in it, of which those whose name contains any of ``only``."""
    files = [path] if path.is_file() else sorted(path.glob("*.xml"))
    if not files:
        raise SystemExit(f"{path}: no scene (*.xml) is there")
    return [f for f in files if not only or any(word in f.stem for word in only)]


def code_digest() -> str:
    """Changes with every line of the program: results of other code are not resumed."""
    root = Path(raytrace2.__file__).parent
    digest = hashlib.sha256()
    for file in sorted(root.rglob("*.py")):
        digest.update(str(file.relative_to(root)).encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(str(c).replace("|", "\\|") for c in line) + " |\n" for line in lines)


def save_text(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, text.encode())


def save_json(path: Path, value: Any) -> None:
    save_text(path, json.dumps(value, indent=1) + "\n")


def save_image(path: Path, pixels: np.ndarray) -> None:
    """Writes (H, W, 3) uint8 as PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, format="PNG")
    write_atomically(path, stream.getvalue())


def read_json(path: Path) -> Any:
    """What :func:`save_json` wrote; None if there is no such file or it is damaged."""
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError):
        return None


def contact_sheet(path: Path, strips: Sequence[tuple[str, np.ndarray]], columns: int = 2, width: int = 720) -> None:
    """Strips (H, W, 3 uint8) with captions, side by side in ``columns`` columns of ``width`` pixels."""
    from PIL import ImageDraw

    if not strips:
        return
    cells = []
    for caption, strip in strips:
        height = max(1, round(strip.shape[0] * width / strip.shape[1]))
        cell = Image.new("RGB", (width, height + CAPTION_HEIGHT), "white")
        cell.paste(Image.fromarray(strip).resize((width, height), Image.Resampling.LANCZOS), (0, CAPTION_HEIGHT))
        ImageDraw.Draw(cell).text((2, 1), caption, fill="black")
        cells.append(cell)
    rows = [cells[i : i + columns] for i in range(0, len(cells), columns)]
    heights = [max(cell.height for cell in row) for row in rows]
    sheet = Image.new("RGB", (width * columns, sum(heights)), "white")
    for k, row in enumerate(rows):
        for i, cell in enumerate(row):
            sheet.paste(cell, (i * width, sum(heights[:k])))
    save_image(path, np.asarray(sheet))
