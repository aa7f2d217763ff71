"""Draws the textures of the scenes here: ``python make_textures.py [FOLDER]``, by default ``textures`` beside this.

Everything is computed with NumPy, without random numbers or fonts; Pillow only writes the files. Drawings are made at
four times their size and averaged in linear light, since a texture that is itself aliased would hide what a renderer
does.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

OVERSAMPLING = 4

CREAM, CHARCOAL, BRICK, GROUT = (236, 226, 204), (44, 46, 52), (176, 74, 48), (120, 112, 100)
WALLPAPER, STRIPE, WOOD, DARK_WOOD, GOLD = (122, 152, 148), (106, 138, 136), (128, 82, 50), (78, 48, 30), (206, 160, 70)
SEA, LAND, HIGHLAND, GRATICULE, ICE = (52, 116, 178), (224, 202, 134), (166, 128, 76), (20, 36, 60), (240, 240, 236)
PAPER, INK, RED, YELLOW, BLUE = (240, 236, 224), (30, 28, 34), (196, 44, 36), (236, 190, 50), (36, 72, 150)


class Canvas:
    """``x`` and ``y``: pixel centres in units of the drawing, y downwards from the top; ``fill`` paints where told."""

    def __init__(self, width: int, height: int, extent: tuple[float, float], ground: tuple[int, int, int]) -> None:
        n = OVERSAMPLING
        self.x, self.y = np.meshgrid(
            (np.arange(width * n) + 0.5) / (width * n) * extent[0],
            (np.arange(height * n) + 0.5) / (height * n) * extent[1],
        )
        self.pixels = np.empty((height * n, width * n, 3), np.uint8)
        self.pixels[:] = ground

    def fill(self, where: np.ndarray, color: tuple[int, int, int]) -> None:
        self.pixels[where] = color

    def finish(self) -> np.ndarray:
        """The drawing at its own size, (height, width, 3) uint8, sRGB."""
        n, linear = OVERSAMPLING, _to_linear(self.pixels / 255.0)
        height, width = linear.shape[0] // n, linear.shape[1] // n
        encoded = _to_srgb(linear.reshape(height, n, width, n, 3).mean(axis=(1, 3)))
        return np.round(encoded * 255.0).astype(np.uint8)


def floor() -> np.ndarray:
    """Two by two checks with thin joints and a diamond set into every corner; it repeats."""
    c = Canvas(128, 128, (2.0, 2.0), CREAM)
    c.fill((np.floor(c.x) + np.floor(c.y)) % 2 == 1, CHARCOAL)
    to_joint_x, to_joint_y = (np.abs(v - np.round(v)) for v in (c.x, c.y))
    c.fill(np.minimum(to_joint_x, to_joint_y) < 0.012, GROUT)
    c.fill(to_joint_x + to_joint_y < 0.17, GROUT)
    c.fill(to_joint_x + to_joint_y < 0.15, BRICK)
    return c.finish()


def wall() -> np.ndarray:
    """A stretch of wall, 9.6 by 4.2, repeating sideways: panelling, above it striped paper and three pictures."""
    c = Canvas(768, 336, (9.6, 4.2), WALLPAPER)
    c.fill(c.x % 0.3 < 0.1, STRIPE)
    panelling = c.y > 3.2
    c.fill(panelling, WOOD)
    in_panel = np.maximum(np.abs(c.x % 0.8 - 0.4) - 0.28, np.abs(c.y - 3.66) - 0.26)
    c.fill(panelling & (np.abs(in_panel) < 0.025), DARK_WOOD)
    c.fill((np.abs(c.y - 3.2) < 0.05) | (c.y > 4.08), DARK_WOOD)
    c.fill(c.y < 0.12, PAPER)
    c.fill(np.abs(c.y - 0.14) < 0.03, GOLD)
    for middle, picture in ((1.6, _zone_plate), (4.8, _color_planes), (8.0, _page)):
        u, v = c.x - middle, c.y - 1.65
        edge = np.maximum(np.abs(u) - 1.15, np.abs(v) - 0.95)
        c.fill(edge < 0.14, DARK_WOOD)
        c.fill(edge < 0.11, GOLD)
        c.fill(edge < 0.02, DARK_WOOD)
        picture(c, edge < 0.0, u, v)
    return c.finish()


def _zone_plate(c: Canvas, inside: np.ndarray, u: np.ndarray, v: np.ndarray) -> None:
    """Rings whose spacing shrinks outwards: whatever the distance, some of them alias."""
    c.fill(inside, PAPER)
    rings = np.cos(34.0 * (u * u + v * v)) > 0.0
    c.fill(inside & rings, BLUE)


def _color_planes(c: Canvas, inside: np.ndarray, u: np.ndarray, v: np.ndarray) -> None:
    """Planes of colour between black bars."""
    c.fill(inside, PAPER)
    c.fill(inside & (u < 0.15) & (v < 0.2), RED)
    c.fill(inside & (u > 0.65) & (v > 0.2), YELLOW)
    c.fill(inside & (u < -0.55) & (v > 0.2), BLUE)
    for bar in (np.abs(u - 0.15), np.abs(v - 0.2), np.where(v > 0.2, np.abs(u + 0.55), 1.0),
                np.where(u > 0.15, np.abs(v + 0.45), 1.0), np.where(v > 0.2, np.abs(u - 0.65), 1.0)):  # fmt: skip
        c.fill(inside & (bar < 0.035), INK)


def _page(c: Canvas, inside: np.ndarray, u: np.ndarray, v: np.ndarray) -> None:
    """Lines of marks that look like print: cells of 3 by 5 dots, each word as long as a hash of its place says."""
    c.fill(inside, PAPER)
    column, row = np.floor(u / 0.04).astype(int), np.floor(v / 0.04).astype(int)
    line, in_line = row // 7, row % 7
    letter, in_letter = column // 4, column % 4
    mark = _hash(letter, line, in_letter, in_line) % 100 < 62
    gap = _hash(letter, line, 0, 7) % 5 == 0
    text = (in_line < 5) & (in_letter < 3) & mark & ~gap & (np.abs(u) < 0.96) & (np.abs(v) < 0.77)
    c.fill(inside & text, INK)
    c.fill(inside & (np.abs(u + 0.7) < 0.26) & (np.abs(v + 0.5) < 0.26), RED)
    c.fill(inside & (np.abs(np.hypot(u + 0.7, v + 0.5) - 0.15) < 0.045), PAPER)


def _hash(*values: int | np.ndarray) -> np.ndarray:
    """A 32-bit mix of integers (Jenkins's one-at-a-time)."""
    h: np.ndarray | np.uint32 = np.uint32(0)
    with np.errstate(over="ignore"):
        for value in values:
            h = h + np.asarray(value).astype(np.uint32)
            h = h + (h << np.uint32(10))
            h = h ^ (h >> np.uint32(6))
        h = h + (h << np.uint32(3))
        h = h ^ (h >> np.uint32(11))
    return np.asarray(h + (h << np.uint32(15)))


def globe() -> np.ndarray:
    """A map of no known world, longitude by latitude, with its grid of 15 degrees: for a sphere, north at the top."""
    c = Canvas(512, 256, (2.0 * np.pi, np.pi), SEA)
    x, y, z = np.sin(c.y) * np.cos(c.x), np.sin(c.y) * np.sin(c.x), np.cos(c.y)
    height = np.zeros_like(x)
    # Waves along directions spread evenly by the golden angle, evaluated in space so that the map closes upon itself
    for k in range(40):
        up = 1.0 - 2.0 * (k * 0.381966 % 1.0)
        around = 2.399963 * k
        frequency = 1.8 * 1.085**k
        direction = np.sqrt(1.0 - up * up) * np.cos(around), np.sqrt(1.0 - up * up) * np.sin(around), up
        phase = frequency * (x * direction[0] + y * direction[1] + z * direction[2]) + 1.7 * k * k
        height += np.sin(phase) / frequency**0.8
    slope = np.hypot(*np.gradient(height, np.pi / len(height)))
    c.fill(height > 0.45, LAND)
    c.fill(height > 1.05, HIGHLAND)
    c.fill(np.abs(height - 0.45) < 0.009 * slope, INK)
    c.fill(np.abs(z) + 0.03 * height > 0.965, ICE)
    # Towards the poles only every third meridian goes on
    step = np.where(np.abs(z) < 0.93, np.pi / 12.0, np.pi / 4.0)
    to_meridian = np.abs(c.x - step * np.round(c.x / step)) * np.sin(c.y)
    to_parallel = np.abs(c.y - np.pi / 12.0 * np.round(c.y / (np.pi / 12.0)))
    c.fill((np.minimum(to_meridian, to_parallel) < 0.008) & (np.abs(z) < 0.995), GRATICULE)
    c.fill(np.abs(c.y - np.pi / 2.0) < 0.022, RED)
    return c.finish()


def sky() -> np.ndarray:
    """From the zenith down: blue, paler towards where a horizon would be, and the same below it."""
    down = (np.arange(64)[:, None, None] + 0.5) / 64.0
    t = np.clip((down - 0.48) / 0.2, 0.0, 1.0)
    t = t * t * (3.0 - 2.0 * t)
    linear = (1.0 - t) * np.array([0.06, 0.16, 0.42]) + t * np.array([0.32, 0.46, 0.58])
    return np.round(_to_srgb(linear.repeat(4, axis=1)) * 255.0).astype(np.uint8)


def checks() -> np.ndarray:
    """Black and white checks of 16 texels, 1024 by 1024: nothing between them, so that any error is the renderer's."""
    row, column = np.divmod(np.arange(1024 * 1024).reshape(1024, 1024), 1024)
    white = (row // 16 + column // 16) % 2 == 1
    return np.where(white, np.uint8(255), np.uint8(0))


#: File name and what draws it.
TEXTURES: dict[str, Callable[[], np.ndarray]] = {
    "floor.png": floor, "wall.png": wall, "globe.png": globe, "sky.png": sky, "checks.png": checks,
}  # fmt: skip


def _to_linear(encoded: np.ndarray) -> np.ndarray:
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def _to_srgb(linear: np.ndarray) -> np.ndarray:
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)


def main(folder: Path) -> None:
    """Writes every texture into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, draw in TEXTURES.items():
        Image.fromarray(draw()).save(folder / name, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "textures")
