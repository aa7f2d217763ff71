"""What hostile input does: mutated scenes, dicts, mesh and image files and arguments, each in a child process that may
die of it, and the same broken files through Mitsuba. Writes out/hostile_input.md and out/hostile_input.png.

    python experiments/hostile_input.py [--cases 10000] [--start 0] [--only xml dict ...] [--no-mitsuba] [-o out]

Sections: "Mutated inputs", "Process kills", "Bugs". Exit status 1 if any case is a bug. Kinds that are done are resumed
as long as the program is the same.
"""

from __future__ import annotations

import argparse
import collections
import hashlib
import sys
import tempfile
from pathlib import Path
from typing import Any

import raytrace2  # noqa: F401  settles libLLVM before anything imports drjit

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "fuzzing"))

import fuzz_cases
import fuzz_files
import fuzz_fixed
import fuzz_judge
import fuzz_parent
import numpy as np
from PIL import Image, ImageDraw
from study import code_digest, markdown_table, read_json, save_image, save_json, save_text
from tqdm import tqdm

SHARES = {
    "xml": 30,
    "dict": 15,
    "ply": 10,
    "obj": 6,
    "serialized": 6,
    "png": 6,
    "jpg": 4,
    "bmp": 4,
    "exr": 6,
    "api": 13,
}
CLASSES = (fuzz_judge.FINE, fuzz_judge.REFUSED, *fuzz_judge.BUGS)
COLORS = ("#4c9f70", "#8ab6d6", "#e0b34f", "#d98032", "#c0504d", "#7a1f1f", "#402040")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--cases", type=int, default=10_000, help="mutated inputs in all")
    parser.add_argument("--start", type=int, default=0, help="number of the first case of each kind")
    parser.add_argument("--only", nargs="*", default=list(SHARES), choices=list(SHARES), help="these kinds alone")
    parser.add_argument("--no-mitsuba", action="store_true", help="leave out the files that Mitsuba is to read")
    parser.add_argument("-o", "--output", type=Path, default=Path("out"), help="folder for the report")
    options = parser.parse_args()
    stored = options.output / "hostile_input.json"
    key = f"{digest()} {options.cases} {options.start}"
    done: dict[str, Any] = read_json(stored) or {}
    done = done if done.get("key") == key else {"key": key}

    def count(name: str, cases: list[tuple[Any, ...]], module: str) -> None:
        if name in done:
            return
        classes: collections.Counter[str] = collections.Counter()
        groups: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
        bugs = []
        with tqdm(total=len(cases), desc=name) as bar, tempfile.TemporaryDirectory() as folder:

            def tell(case: Any, outcome: str, message: str) -> None:
                classes[outcome] += 1
                groups[str(case[1] if module == "fuzz_files" else "")][outcome] += 1
                if outcome in fuzz_judge.BUGS:
                    bugs.append([" ".join(map(str, case)), outcome, " ".join(message.split())[:200]])
                bar.update()

            fuzz_parent.run_all(cases, Path(folder), module=module, tell=tell)
        done[name] = {"classes": dict(classes), "groups": groups, "bugs": bugs}
        save_json(stored, done)

    for kind in options.only:
        first, share = options.start, -(-options.cases * SHARES[kind] // 100)
        count(kind, [(kind, n) for n in range(first, first + share)], "fuzz_cases")
    count("attacks by name", [(name,) for name in fuzz_fixed.ATTACKS], "fuzz_fixed")
    for who in ("ours",) if options.no_mitsuba else ("ours", "mitsuba"):
        count(f"files {who}", [(who, *case) for case in fuzz_files.KINDS], "fuzz_files")
    return report(done, options.output)


def digest() -> str:
    """Changes with the program and with the cases."""
    texts = b"".join(path.read_bytes() for path in sorted(Path(fuzz_cases.__file__).parent.glob("*.py")))
    return code_digest() + hashlib.sha256(texts).hexdigest()[:16]


def report(done: dict[str, Any], folder: Path) -> int:
    """Writes table and picture; 1 if there are bugs of ours."""
    names = [name for name in (*fuzz_cases.KINDS, "attacks by name") if name in done]
    counts = {name: [done[name]["classes"].get(c, 0) for c in CLASSES] for name in names}
    rows = [[name, f"{sum(n):,}", *(f"{x:,}" for x in n)] for name, n in counts.items()]
    totals = np.sum(list(counts.values()), axis=0)
    rows.append(["all", f"{totals.sum():,}", *(f"{x:,}" for x in totals)])
    text = "# Hostile input\n\n## Mutated inputs\n\n" + markdown_table(["input", "cases", *CLASSES], rows)
    text += (
        "\nEach case runs in a child process with 8 GB of memory and a minute of time. Refused means one line a "
        "problem, from an error that is raised on purpose; scenes that load are rendered at 4 x 4 pixels, "
        "all of which must be finite.\n\n## Process kills\n\n"
    )
    text += markdown_table(["set", "read by", "files", "fine", "refused", "not finite", "killed", "hung"], kills(done))
    text += (
        f"\nBroken files: {', '.join(f'{n} {kind}' for kind, n in fuzz_files.BROKEN.items())}, each after one to "
        "three "
        f"random accidents (bytes changed, cut, numbers exchanged). Four bytes: {fuzz_files.FOUR_BYTES} "
        "copies of a sphere of 1280 faces as binary ply, four bytes of the body of each changed. All are loaded and "
        "rendered at 4 x 4 pixels; Mitsuba in its variant llvm_ad_rgb.\n\n## Bugs\n\n"
    )
    bugs = [bug for name in (*names, "files ours") for bug in done[name]["bugs"]]
    text += markdown_table(["case", "class", "message"], bugs) if bugs else "None.\n"
    save_text(folder / "hostile_input.md", text)
    picture(folder / "hostile_input.png", counts)
    print(text)
    return int(bool(bugs))


def kills(done: dict[str, Any]) -> list[list[str]]:
    rows = []
    for group, label in (("broken", "broken files"), ("four bytes", "ply, four bytes changed")):
        total = sum(case[0] == group for case in fuzz_files.KINDS)
        for who in ("mitsuba", "ours"):
            if f"files {who}" not in done:
                continue
            classes = done[f"files {who}"]["groups"][group]
            shown = (fuzz_judge.FINE, fuzz_judge.REFUSED, fuzz_judge.NONSENSE, fuzz_judge.SIGNAL, fuzz_judge.HANG)
            rows.append([label, who, str(total), *(str(classes.get(name, 0)) for name in shown)])
    return rows


def picture(path: Path, counts: dict[str, list[int]]) -> None:
    """Bars of the classes, a kind a row."""
    row, width, left = 26, 900, 130
    image = Image.new("RGB", (width, row * (len(counts) + 1) + 8), "white")
    draw = ImageDraw.Draw(image)
    for k, (name, numbers) in enumerate(counts.items()):
        draw.text((4, k * row + 8), name, fill="black")
        x, total = float(left), max(sum(numbers), 1)
        for number, color in zip(numbers, COLORS, strict=True):
            end = x + (width - left - 8) * number / total
            if number:
                draw.rectangle((x, k * row + 4, max(end, x + 2), k * row + row - 2), fill=color)
            x = end
    x = left
    for name, color in zip(CLASSES, COLORS, strict=True):
        draw.rectangle((x, len(counts) * row + 8, x + 10, len(counts) * row + 18), fill=color)
        draw.text((x + 14, len(counts) * row + 8), name, fill="black")
        x += 108
    save_image(path, np.asarray(image))


if __name__ == "__main__":
    sys.exit(main())
