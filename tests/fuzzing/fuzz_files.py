"""Two fixed sets of broken files, read by us and, in a process of its own, by Mitsuba."""

from __future__ import annotations

import random
import struct
from pathlib import Path

import fuzz_bytes
import fuzz_cases
import fuzz_judge
import numpy as np

#: How many files of each kind the first set has: 173 in all.
BROKEN = {"ply": 45, "obj": 32, "serialized": 32, "png": 24, "jpg": 16, "exr": 24}
#: The second set: a sphere of 1280 faces as binary ply, four bytes of whose body are changed.
FOUR_BYTES = 200
KINDS = [("broken", kind, n) for kind, count in BROKEN.items() for n in range(count)]
KINDS += [("four bytes", "ply", n) for n in range(FOUR_BYTES)]


def content(group: str, kind: str, number: int, folder: Path) -> bytes:
    """The broken file."""
    rng = random.Random(f"{group} {kind} {number}")
    if group == "broken":
        return fuzz_cases.case_bytes(kind, rng, folder)
    intact = sphere_ply()
    return fuzz_bytes.four_bytes(intact, rng, intact.index(b"end_header\n") + len(b"end_header\n"))


def sphere_ply(rings: int = 21, columns: int = 32) -> bytes:
    """A sphere of 1280 faces as little-endian binary ply."""
    v, u = np.meshgrid(np.linspace(0, np.pi, rings), np.linspace(0, 2 * np.pi, columns, endpoint=False), indexing="ij")
    points = np.stack([np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(v)], axis=-1).reshape(-1, 3)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(rings - 1), np.arange(columns), indexing="ij"))
    a, b = i * columns + j, i * columns + (j + 1) % columns
    faces = np.concatenate([np.stack([a, a + columns, b], -1), np.stack([b, a + columns, b + columns], -1)])
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    body = b"".join(struct.pack("<B3i", 3, *map(int, face)) for face in faces)
    return header.encode() + points.astype("<f4").tobytes() + body


def run(who: str, group: str, kind: str, number: int, folder: Path) -> tuple[str, str]:
    """What becomes of the file when ``who`` ("ours" or "mitsuba") loads it and renders 4 x 4 pixels of it."""
    data = content(group, kind, number, folder)
    if who == "ours":
        return fuzz_judge.judge(fuzz_cases.file_call(kind, data, folder))
    fuzz_cases.file_call(kind, data, folder)
    return _mitsuba(folder / "around.xml")


def _mitsuba(path: Path) -> tuple[str, str]:
    import mitsuba as mi

    if mi.variant() != "llvm_ad_rgb":
        mi.set_variant("llvm_ad_rgb")
    mi.set_log_level(mi.LogLevel.Error)
    try:
        image = np.array(mi.render(mi.load_file(str(path)), spp=1))
    except Exception as error:
        return "refused", f"{type(error).__name__}: {error}"[:500]
    return ("fine", "") if np.isfinite(image).all() else (fuzz_judge.NONSENSE, "pixels that are not finite")
