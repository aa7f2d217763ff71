"""Do our renders equal Mitsuba's but for noise? Every scene of a folder, both ways, with the verdict of the noise test.

    python experiments/gallery.py FOLDER [--spp 64] [--scale 0.25] [--only WORD ...] [--out out/gallery]

Writes gallery.md (the table) and gallery.png (ours, Mitsuba's, ten times their difference). Interrupted, it goes on
where it was; results of other code or settings are made anew.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from study import code_digest, contact_sheet, markdown_table, read_json, save_image, save_json, save_text, scene_files
from tqdm import tqdm

import raytrace2 as rt
from raytrace2.reference.report import srgb_bytes

HEAD = ["scene", "verdict", "RMSE", "FLIP", "failing pixels (chance)", "p exact", "p pixels", "p tiles", "p mean",
        "mean difference", "seconds", "Mitsuba"]  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("path", type=Path, help="a folder of Mitsuba scenes, or one scene")
    parser.add_argument("--spp", type=int, default=64, help="samples per pixel on both sides")
    parser.add_argument("--scale", type=float, default=0.25, help="image size, as a fraction of the scene's own")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", default=[], help="scenes whose name contains any of these words")
    parser.add_argument("--out", type=Path, default=Path("out/gallery"))
    options = parser.parse_args()
    settings = {"code": code_digest(), "spp": options.spp, "scale": options.scale, "seed": options.seed}
    records, strips = [], []
    for file in tqdm(scene_files(options.path, options.only), unit="scene", disable=None):
        record, strip = one(file, options, settings)
        records.append(record)
        if strip is not None:
            strips.append((f"{file.stem}: {record['verdict']}", strip))
        tqdm.write(line(record))
    summary = totals(records)
    print(summary)
    table = markdown_table(HEAD, [row(r) for r in records])
    about = f"{options.spp} samples per pixel, {options.scale:g} of the resolution, seed {options.seed}.\n\n"
    refused = "".join(f"- {r['scene']}: {r['refusal']}\n" for r in records if r["refusal"])
    reasons = "".join(f"- {r['scene']}: {'; '.join(r['reasons'])}\n" for r in records if r.get("reasons"))
    text = f"# Our renders and Mitsuba's\n\n{about}{table}\n{summary}\n"
    text += f"\nDifferences:\n{reasons}" * bool(reasons) + f"\nRefused:\n{refused}" * bool(refused)
    save_text(options.out / "gallery.md", text)
    contact_sheet(options.out / "gallery.png", strips)
    print(f"written: {options.out / 'gallery.md'}, {options.out / 'gallery.png'}")
    return int(any(r["verdict"] == "DIFFERS" for r in records))


def one(file: Path, options: argparse.Namespace, settings: dict[str, Any]) -> tuple[dict[str, Any], np.ndarray | None]:
    """The record of one scene and its strip of pictures; taken from the output folder if it is there already."""
    stem = options.out / "scenes" / file.stem
    stored, picture = read_json(stem.with_suffix(".json")), stem.with_suffix(".png")
    try:
        scene = rt.load_file(file, spp=options.spp)
    except rt.RayTraceError as error:
        return {"scene": file.stem, "verdict": "refused", "refusal": first_line(error, file)}, None
    settings = {**settings, "scene": scene.description.hash}
    if stored is not None and stored["settings"] == settings and picture.is_file():
        return stored, np.asarray(Image.open(picture))
    film = scene.description.cameras[0].film
    size = (max(1, round(film.width * options.scale)), max(1, round(film.height * options.scale)))
    found = rt.compare(scene, spp=options.spp, seed=options.seed, size=size)
    noise = found.noise
    record = {
        "scene": file.stem, "settings": settings, "refusal": "",
        "verdict": "noise" if found.consistent else "DIFFERS", "reasons": list(noise.reasons),
        "rmse": found.rmse, "flip": found.flip, "failing": noise.failing_share, "chance": noise.chance_share,
        "p": [noise.p_exact, noise.p_pixels, noise.p_tiles, noise.p_mean], "mean": list(noise.mean_difference),
        "seconds": found.seconds, "reference_seconds": found.reference_seconds,
    }  # fmt: skip
    difference = 10 * np.abs(found.ours - found.reference)
    strip = np.concatenate([srgb_bytes(image) for image in (found.ours, found.reference, difference)], axis=1)
    save_image(picture, strip)
    save_json(stem.with_suffix(".json"), record)
    return record, strip


def first_line(error: Exception, file: Path) -> str:
    lines = str(error).replace(f"{file.parent}/", "").splitlines()
    return lines[0] + (f" (and {len(lines) - 1} more)" if len(lines) > 1 else "")


def row(record: dict[str, Any]) -> list[str]:
    if record["refusal"]:
        return [record["scene"], "refused", *["" for _ in HEAD[2:]]]
    return [
        record["scene"], record["verdict"], f"{record['rmse']:.4g}", f"{record['flip']:.4f}",
        f"{record['failing']:.2%} ({record['chance']:.2%})", *[f"{p:.2g}" for p in record["p"]],
        ", ".join(f"{d:+.2%}" for d in record["mean"]), f"{record['seconds']:.3g}",
        f"{record['reference_seconds']:.3g}",
    ]  # fmt: skip


def line(record: dict[str, Any]) -> str:
    name = f"{record['scene']:34s} "
    if record["refusal"]:
        return name + "refused: " + record["refusal"]
    cells = row(record)
    return name + f"{cells[1]:8s} RMSE {cells[2]:9s} FLIP {cells[3]} failing {cells[4]:16s} p " + " ".join(
        f"{c:8s}" for c in cells[5:9]) + f" {cells[10]} s / {cells[11]} s"  # fmt: skip


def totals(records: list[dict[str, Any]]) -> str:
    rendered = [r for r in records if not r["refusal"]]
    same = sum(r["verdict"] == "noise" for r in rendered)
    return (
        f"{len(records)} scenes: {len(rendered)} render, {same} of them equal Mitsuba's but for noise, "
        f"{len(records) - len(rendered)} refused."
    )


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit("interrupted: the same command goes on from here")
