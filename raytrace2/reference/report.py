"""A comparison as one self-contained HTML page that a hand and a keyboard can drive."""

from __future__ import annotations

import base64
import html
import json
import os
import struct
import tempfile
import zlib
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np
import numpy.typing as npt

from .metrics import pair
from .windows import window_means, windows

# sRGB anchors of the magma colour map (van der Walt and Smith 2015), in which FLIP maps are customarily shown.
_MAGMA = (
    (0, 0, 4),
    (28, 16, 68),
    (79, 18, 123),
    (129, 37, 129),
    (181, 54, 122),
    (229, 80, 100),
    (251, 135, 97),
    (254, 194, 135),
    (252, 253, 191),
)
# Blue for too dark, red for too bright, after ColorBrewer's RdBu.
_BLUE_RED = (
    (5, 48, 97),
    (67, 147, 195),
    (209, 229, 240),
    (247, 247, 247),
    (253, 219, 199),
    (214, 96, 77),
    (103, 0, 31),
)
_Z_SHOWN = 5.0


def write_report(
    path: str | os.PathLike[str],
    *,
    ours: npt.ArrayLike,
    reference: npt.ArrayLike,
    title: str,
    figures: Mapping[str, str],
    settings: Mapping[str, str] | None = None,
    consistent: bool | None = None,
    reasons: Sequence[str] = (),
    flip_map: npt.ArrayLike | None = None,
    z: npt.ArrayLike | None = None,
    worst_tile: tuple[int, int, int, int] | None = None,
    names: tuple[str, str] = ("raytrace2", "Mitsuba"),
) -> Path:
    """Writes the page to ``path``, whole or not at all, and returns the path.

    ``ours`` and ``reference`` are (H, W, 3) linear; ``figures`` and ``settings`` are rows of its tables, in order;
    ``consistent`` and ``reasons`` the verdict of the noise test; ``flip_map`` (H, W) in [0, 1]; ``z`` (H, W) signed;
    ``worst_tile`` (y0, x0, y1, x1), by default the window of 16 pixels with the greatest squared difference.
    """
    a, b = pair(ours, reference)
    verdict = None
    if consistent is not None:
        text = "The difference is no more than noise" if consistent else "The images differ by more than noise"
        verdict = {"good": bool(consistent), "text": text}
    data = {
        "title": title,
        "width": a.shape[1],
        "height": a.shape[0],
        "names": list(names),
        "verdict": verdict,
        "reasons": list(reasons),
        "figures": list(figures.items()),
        "settings": list((settings or {}).items()),
        "ours": _half_planes(a),
        "reference": _half_planes(b),
        "tile": _tile(a, b, worst_tile),
        "flip": None if flip_map is None else _map(np.asarray(flip_map), _MAGMA),
        "z": None if z is None else _map(0.5 + 0.5 * np.asarray(z) / _Z_SHOWN, _BLUE_RED),
        "exposure": _exposure(b),
        "gain": _gain(a - b),
    }
    # "<" would let a scene's name end the script element that holds the data.
    text = json.dumps(data, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")
    page = files(__package__).joinpath("report.html").read_text(encoding="utf-8")
    page = page.replace("{{title}}", html.escape(title), 1).replace("{{data}}", text, 1)
    return _write_whole(Path(path), page)


def png_uri(rgb: np.ndarray) -> str:
    """An (H, W, 3) uint8 image as a PNG data URI."""
    height, width = rgb.shape[:2]
    rows = np.zeros((height, 1 + 3 * width), dtype=np.uint8)
    rows[:, 1:] = rgb.reshape(height, -1)

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = zlib.compress(rows.tobytes(), 6)
    png = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", body) + chunk(b"IEND", b"")
    return "data:image/png;base64," + base64.b64encode(png).decode()


def srgb_bytes(linear: npt.ArrayLike) -> np.ndarray:
    """Linear radiance to sRGB-encoded uint8, cut off at 0 and 1; what is not a number becomes magenta."""
    x = np.asarray(linear, dtype=np.float64)
    v = np.clip(np.nan_to_num(x, nan=0.0), 0.0, 1.0)
    encoded = np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** (1.0 / 2.4) - 0.055)
    return np.where(np.isnan(x).any(axis=-1, keepdims=True), [255, 0, 255], np.rint(255.0 * encoded)).astype(np.uint8)


def _half_planes(image: np.ndarray) -> list[str]:
    """High and low bytes of the half-precision pixels: radiance beyond 65504 is shown as that."""
    with np.errstate(over="ignore"):
        bits = np.clip(image, -65504.0, 65504.0).astype(np.float16).view(np.uint16)
    return [png_uri((bits >> 8).astype(np.uint8)), png_uri((bits & 255).astype(np.uint8))]


def _map(values: np.ndarray, colors: Sequence[tuple[int, int, int]]) -> dict[str, object]:
    anchors = np.linspace(0.0, 1.0, len(colors))
    v = np.clip(np.nan_to_num(values, nan=1.0), 0.0, 1.0)
    rgb = np.stack([np.interp(v, anchors, [c[i] for c in colors]) for i in range(3)], axis=-1)
    return {"image": png_uri(np.rint(rgb).astype(np.uint8)), "scale": [f"rgb({r} {g} {b})" for r, g, b in colors]}


def _tile(a: np.ndarray, b: np.ndarray, tile: tuple[int, int, int, int] | None) -> list[int]:
    height, width = a.shape[:2]
    if tile is None:
        grid = windows((height, width), (16,))
        squares = np.nan_to_num((a - b) ** 2, nan=1e30, posinf=1e30).clip(max=1e30)
        i = int(window_means(squares, grid).sum(axis=1).argmax())
        tile = (int(grid.y0[i]), int(grid.x0[i]), int(grid.y1[i]), int(grid.x1[i]))
    y0, x0, y1, x1 = (int(v) for v in tile)
    if not (0 <= y0 < y1 <= height and 0 <= x0 < x1 <= width):
        raise ValueError(f"worst_tile {tile} does not lie within an image of {height} rows and {width} columns")
    return [y0, x0, y1, x1]


def _exposure(image: np.ndarray) -> float:
    """Whole stops that bring the 99th percentile to white, for images much brighter or darker than a screen; else 0."""
    finite = np.abs(image[np.isfinite(image)])
    bright = float(np.percentile(finite, 99.0)) if finite.size else 0.0
    if bright <= 0.0 or 0.1 <= bright <= 4.0:
        return 0.0
    return float(np.clip(np.round(-np.log2(bright)), -6.0, 6.0))


def _gain(difference: np.ndarray) -> float:
    """Stops of gain that bring the 99th percentile of the difference to about half the scale."""
    finite = np.abs(difference[np.isfinite(difference)])
    large = float(np.percentile(finite, 99.0)) if finite.size else 0.0
    return 0.0 if large <= 0.0 else float(np.clip(np.round(np.log2(0.5 / large)), -4.0, 10.0))


def _write_whole(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile("w", dir=path.parent, suffix=".tmp", encoding="utf-8", delete=False) as stream:
        temporary = Path(stream.name)
        try:
            stream.write(text)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
    temporary.chmod(0o644)
    os.replace(temporary, path)
    return path
