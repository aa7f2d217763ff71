"""What sheets of pictures are put together from: captions, legends and heat maps, as (H, W, 3) uint8 images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont

#: The heat map's stops: no cost black, the greatest white.
_HEAT = np.array([[0, 0, 4], [60, 15, 110], [150, 45, 128], [230, 80, 95], [254, 160, 110], [252, 253, 191]])
_LINE, _MARGIN, _SWATCH = 14, 4, 10
_INK = (230, 230, 230)


@dataclass(frozen=True)
class Legend:
    """A line of a legend: a colour and what it stands for."""

    color: tuple[int, ...]
    text: str


def heat(values: np.ndarray) -> np.ndarray:
    """(H, W) values from 0 to 1 as colours."""
    stops = np.linspace(0, 1, len(_HEAT))
    channels = [np.interp(values, stops, _HEAT[:, c]) for c in range(3)]
    return np.stack(channels, axis=-1).astype(np.uint8)


def heat_scale(greatest: float, meaning: str, width: int) -> np.ndarray:
    """The colours of a heat map from 0 to ``greatest``, and what of."""
    lines = _wrapped(f"0 (black) to {greatest:.0f} (white) {meaning}", width - 2 * _MARGIN)
    bar = heat(np.broadcast_to(np.linspace(0, 1, width - 2 * _MARGIN), (_SWATCH, width - 2 * _MARGIN)))
    return np.concatenate([np.pad(bar, ((_MARGIN, 0), (_MARGIN, _MARGIN), (0, 0))), _block(lines, width, len(lines))])


def caption(columns: Sequence[str | Sequence[Legend]], width: int) -> list[np.ndarray]:
    """A block of text or a legend for each column, ``width`` pixels wide and all of the same height."""
    blocks = [_lines(column, width - 2 * _MARGIN) for column in columns]
    most = max(map(len, blocks))
    return [_block(lines, width, most) for lines in blocks]


def stacked(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Images of one width, one below the other."""
    return np.concatenate(parts, axis=0)


def _lines(column: str | Sequence[Legend], width: int) -> list[str | Legend]:
    if isinstance(column, str):
        return [*_wrapped(column, width)]
    found: list[str | Legend] = []
    for entry in column:
        first, *rest = _wrapped(entry.text, width - _SWATCH - _MARGIN)
        found += [Legend(entry.color, first), *(Legend((0, 0, 0), line) for line in rest)]
    return found


def _wrapped(text: str, width: int) -> list[str]:
    """``text`` in lines of at most ``width`` pixels, broken between words."""
    font, lines = ImageFont.load_default(), [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if lines[-1] and font.getlength(longer) > width:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines


def _block(lines: Sequence[str | Legend], width: int, height: int) -> np.ndarray:
    picture = Image.new("RGB", (width, height * _LINE + _MARGIN), (0, 0, 0))
    draw = ImageDraw.Draw(picture)
    for k, line in enumerate(lines):
        x, y = _MARGIN, k * _LINE + 2
        if isinstance(line, Legend):
            draw.rectangle((x, y + 1, x + _SWATCH - 1, y + _SWATCH), fill=tuple(int(c) for c in line.color))
            x += _SWATCH + _MARGIN
        draw.text((x, y), line.text if isinstance(line, Legend) else line, fill=_INK)
    return np.asarray(picture)
