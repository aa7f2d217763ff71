"""The room of the texture study, for both renderers: its floor's texture unknown, photographs from three places."""

from __future__ import annotations

import hashlib
import io
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from study import save_text

import raytrace2 as rt
from raytrace2.files import write_atomically

ROOM = Path(__file__).parent.parent / "scenes" / "igehy_room.xml"
#: Where the camera stands.
PLACES = ("0, 0, 1.3", "-2, 1, 1.0", "2.2, 0.5, 1.7")
TEXELS = "floor.bsdf.reflectance.data"
MAX_DEPTH = 8
#: The photographs' samples a pixel, and how many renders make them.
_PHOTOGRAPH = 256, 8


@dataclass(frozen=True, eq=False)
class Room:
    """The scene in our form and in Mitsuba's, the true texels (height, width, 3) and the photographs of the floor."""

    ours: rt.Scene
    mitsuba: Any
    texels: np.ndarray
    photographs: list[np.ndarray]
    digest: str


def make_room(folder: Path, size: int, texels: int) -> Room:
    """The room with a floor of ``texels`` x ``texels`` a tile, seen in images of ``size`` x ``size``; photographs are
    kept in ``folder``."""
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    true = floor_texture(texels)
    folder.mkdir(parents=True, exist_ok=True)
    image = folder / "floor.exr"
    mi.Bitmap(true).write(str(image))
    text = ROOM.read_text().replace("textures/floor.png", str(image.resolve()))
    text = text.replace('"textures/', f'"{ROOM.parent.resolve()}/textures/')
    begin, end = text.index("<sensor"), text.index("</sensor>") + len("</sensor>")
    cameras = [_camera(text[begin:end], k, place) for k, place in enumerate(PLACES)]
    text = text[:begin] + "\n".join(cameras) + text[end:]
    path = folder / "room.xml"
    save_text(path, text)
    scene = mi.load_file(str(path), width=size, height=size)
    digest = hashlib.sha256(text.encode() + true.tobytes() + str((size, _PHOTOGRAPH)).encode()).hexdigest()[:16]
    photographs = _photographs(folder / f"photographs_{digest}.npz", scene)
    return Room(rt.load_file(path, width=size, height=size), scene, true, photographs, digest)


def floor_texture(size: int) -> np.ndarray:
    """Checks of sixteen texels under noise of power 1 / f^2, (size, size, 3) float32 in (0, 1), periodic."""
    random = np.random.default_rng(3)
    frequency = np.fft.fftfreq(size)
    radius = np.hypot(*np.meshgrid(frequency, frequency))
    radius[0, 0] = 1
    planes = []
    for _ in range(3):
        plane = np.fft.ifft2(np.fft.fft2(random.normal(size=(size, size))) / radius).real
        planes.append((plane - plane.mean()) / plane.std())
    cells = np.arange(size) // 16
    checks = (cells[:, None] + cells[None]) % 2 - 0.5
    return np.clip(0.5 + 0.15 * np.stack(planes, -1) + 0.3 * checks[..., None], 0.02, 0.98).astype(np.float32)


def _camera(text: str, number: int, place: str) -> str:
    return re.sub(r'origin="[^"]*"', f'origin="{place}"', text).replace('id="camera"', f'id="camera{number}"')


def _photographs(path: Path, scene: Any) -> list[np.ndarray]:
    import mitsuba as mi

    if path.exists():
        return list(np.load(path)["images"])
    samples, times = _PHOTOGRAPH
    images = np.stack(
        [
            np.mean([mi.render(scene, sensor=k, spp=samples, seed=i).numpy() for i in range(times)], axis=0)
            for k in range(len(PLACES))
        ]
    )
    stream = io.BytesIO()
    np.savez_compressed(stream, images=images)
    write_atomically(path, stream.getvalue())
    return list(images)
