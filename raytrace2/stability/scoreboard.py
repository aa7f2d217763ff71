"""Measures every row of the scoreboard for everyone who takes part, keeping what is done as records in a folder."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from ..errors import SettingError
from ..files import write_atomically
from ..reference.mitsuba_scene import mitsuba_variant
from ..reference.stability_rays import Mitsuba
from . import trade
from .figures import FIGURES, Figure
from .sweep import Counts, Record
from .tracers import Ours, Tracer

PRECISIONS = ("float32", "float64")

#: By figure and precision: what was found of each who took part.
Found = dict[tuple[str, str], dict[str, Record]]

#: By structure and way.
Traded = dict[str, dict[str, Record]]


def run(
    kinds: Sequence[str],
    counts: Counts,
    folder: Path,
    only: Sequence[str] = (),
    progress: Callable[[Found, Traded], None] = lambda _, __: None,
) -> tuple[Found, Traded]:
    """Every figure (or those whose key contains any of ``only``) in both precisions, and the trade of each kind.

    Each is written to ``folder``/stability_records as soon as it is there; of this code, machine and ``counts`` only
    those who are missing there are measured. ``progress`` is called after each with all that is found so far.
    ``SettingError`` if ``only`` names nothing.
    """
    from tqdm import tqdm

    chosen = [f for f in FIGURES if not only or any(word in f.key for word in only)]
    with_trade = not only or any(word in "trade" for word in only)
    if not chosen and not with_trade:
        raise SettingError(f"no figure is called so; there are {', '.join(f.key for f in FIGURES)}, trade")
    settings: Record = {"code": code_digest(), "machine": platform.node(), "counts": asdict(counts)}
    records = folder / "stability_records"
    records.mkdir(parents=True, exist_ok=True)
    found: Found = {}
    traded: Traded = {}
    steps = len(chosen) * len(PRECISIONS) + with_trade * len(kinds)
    with mitsuba_variant("llvm_ad_rgb") as mi, tqdm(total=steps, unit="row", disable=None) as bar:
        for figure in chosen:
            for precision in PRECISIONS:
                bar.set_description(f"{figure.key} {precision}")
                ours: list[Tracer] = [Ours(kind, precision) for kind in kinds]
                theirs: list[Tracer] = []
                if figure.others and precision == "float32":
                    theirs = [Mitsuba(mi, False), Mitsuba(mi, True)]
                file = records / f"{figure.key}.{precision}.json"
                measure = partial(_measured, figure, precision, counts)
                found[figure.key, precision] = _all_kept(file, settings, [*ours, *theirs], measure)
                bar.update()
                progress(found, traded)
        for kind in kinds if with_trade else ():
            bar.set_description(f"trade {kind}")
            file = records / f"trade.{kind.replace(':', '.')}.json"
            traded[kind] = _kept(file, settings, partial(trade.measure, kind, counts))
            bar.update()
            progress(found, traded)
    return found, traded


def broken_files(folder: Path) -> dict[str, str]:
    """How many processes died of broken files, of how many, as a study of hostile input left it in
    ``folder``/hostile_input.json: texts under "Embree default" (which stands for Mitsuba) and "ours"; empty if none
    is there."""
    study = _read(folder / "hostile_input.json") or {}
    texts = {}
    for who, key in (("Embree default", "files mitsuba"), ("ours", "files ours")):
        groups = study.get(key, {}).get("groups", {})
        cells = [
            f"{groups[name].get('signal', 0)} of {sum(groups[name].values())}"
            for name in ("broken", "four bytes")
            if name in groups
        ]
        if cells:
            texts[who] = "; ".join(cells)
    return texts


def code_digest() -> str:
    """Changes with every line that these figures depend on."""
    root = Path(__file__).parent.parent
    files = [f for part in ("accel", "surfaces", "stability") for f in (root / part).rglob("*.py")]
    files += [root / "rays/ray.py", root / "reference/stability_rays.py", root / "buffers.py", root / "types.py"]
    # How results are shown is no part of them.
    shown = {root / "stability" / name for name in ("table.py", "picture.py", "report.py", "scoreboard.py")}
    digest = hashlib.sha256()
    for file in sorted(set(files) - shown):
        digest.update(str(file.relative_to(root)).encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]


def _measured(figure: Figure, precision: str, counts: Counts, tracers: Sequence[Tracer]) -> dict[str, Record]:
    return figure.measure(tracers, precision, counts)


def _all_kept(
    file: Path,
    settings: Record,
    tracers: Sequence[Tracer],
    measure: Callable[[Sequence[Tracer]], dict[str, Record]],
) -> dict[str, Record]:
    """The records of ``tracers``, in their order; those that the file lacks are measured, and the file keeps all."""
    stored = _of(file, settings)
    missing = [t for t in tracers if t.name not in stored]
    if missing:
        stored = _kept(file, settings, lambda: stored | measure(missing), anew=True)
    return {t.name: stored[t.name] for t in tracers}


def _kept(
    file: Path, settings: Record, measure: Callable[[], dict[str, Record]], anew: bool = False
) -> dict[str, Record]:
    stored = {} if anew else _of(file, settings)
    if not stored:
        content = {"settings": settings, "found": measure()}
        write_atomically(file, (json.dumps(content, indent=1, default=_plain) + "\n").encode())
        stored = _of(file, settings) or content["found"]
    return stored


def _of(file: Path, settings: Record) -> dict[str, Record]:
    """What the file holds of these settings; empty if nothing."""
    stored = _read(file)
    if stored is None or stored.get("settings") != settings:
        return {}
    found: dict[str, Record] = stored["found"]
    return found


def _plain(value: Any) -> Any:
    return value.item()


def _read(file: Path) -> Any:
    """What was written there; None if there is no such file or it is damaged."""
    try:
        return json.loads(file.read_text())
    except (OSError, ValueError):
        return None
