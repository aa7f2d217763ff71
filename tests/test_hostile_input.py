# ruff: noqa: E501 -- a case a line
"""Hostile input is refused in one line: mutated scenes, dicts, files and arguments, by seed, in child processes."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent / "fuzzing"))

import fuzz_files
import fuzz_fixed
import fuzz_parent
import fuzz_seeds
import fuzz_xml
from fuzz_judge import BUGS, REFUSED

import raytrace2 as rt

#: A few of the cases of experiments/hostile_input.py, which runs them by the ten thousand.
FRESH = {
    "xml": 60,
    "dict": 40,
    "ply": 20,
    "obj": 12,
    "serialized": 8,
    "png": 12,
    "jpg": 4,
    "bmp": 4,
    "exr": 6,
    "api": 34,
}

#: Every case that was a bug when it was first run.
FOUND = {
    "xml": (106, 159, 461, 523),
    "dict": (11, 97, 307, 339, 471),
    "ply": (4, 14, 22, 108, 175),
    "obj": (4, 7, 11, 58, 184),
    "api": (
        0, 2, 3, 10, 16, 19, 21, 35, 36, 37, 42, 48, 51, 53, 55, 59, 63, 82, 87, 98, 100, 103, 106, 122, 123, 125, 131, 132,
        140, 147, 155, 165, 173, 174, 176, 187, 192, 205, 218, 244, 248, 254, 259, 266, 279, 283, 291, 294, 304, 315, 316,
        330, 345, 355, 416, 442, 489, 492, 498, 504, 517, 10387, 10470, 11269,
    ),
}  # fmt: skip


def bugs(cases: list, folder: Path, module: str = "fuzz_cases") -> list:
    return [result for result in fuzz_parent.run_all(cases, folder, module=module) if result[1] in BUGS]


def test_mutated_input(tmp_path: Path) -> None:
    assert bugs([(kind, 20_000 + n) for kind, count in FRESH.items() for n in range(count)], tmp_path) == []


def test_what_was_once_a_bug_is_none_any_more(tmp_path: Path) -> None:
    assert bugs([(kind, n) for kind, numbers in FOUND.items() for n in numbers], tmp_path) == []


def test_attacks_are_refused_by_name(tmp_path: Path) -> None:
    results = fuzz_parent.run_all([(name,) for name in fuzz_fixed.ATTACKS], tmp_path, module="fuzz_fixed")
    assert [result for result in results if result[1] != REFUSED] == []


def test_files_that_kill_mitsuba_are_refused_or_fine(tmp_path: Path) -> None:
    cases = [("ours", *case) for case in fuzz_files.KINDS[::9]]
    assert bugs(cases, tmp_path, "fuzz_files") == []


@pytest.mark.parametrize("poison", ["nan", "inf"])
def test_no_number_of_a_scene_may_be_poisoned(poison: str, tmp_path: Path) -> None:
    fuzz_seeds.write_files(tmp_path)
    accepted, scenes = [], 0
    for name, xml in fuzz_xml.poisoned(poison):
        scenes += 1
        (tmp_path / "scene.xml").write_text(xml)
        try:
            rt.load_file(tmp_path / "scene.xml")
        except rt.SceneError as error:
            assert "\n" not in str(error).strip() or len(error.problems) == len(str(error).split("\n")), name
        else:
            accepted.append(name)
    assert scenes > 90 and accepted == []


def test_the_seeds_themselves_are_fine(tmp_path: Path) -> None:
    fuzz_seeds.write_files(tmp_path)
    for xml in fuzz_seeds.SCENES.values():
        (tmp_path / "scene.xml").write_text(xml)
        rt.load_file(tmp_path / "scene.xml")


@pytest.mark.parametrize("where", ["beside", "absolute", "above"])
def test_paths_are_relative_to_the_scene_absolute_or_climb(where: str, tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    fuzz_seeds.write_files(folder)
    (tmp_path / "a" / "up.ply").write_bytes(fuzz_seeds.ply("ascii"))
    name = {"beside": "mesh.ply", "absolute": str(folder / "mesh.ply"), "above": "../up.ply"}[where]
    text = f'<scene version="3.0.0"><shape type="ply"><string name="filename" value="{name}"/></shape></scene>'
    (folder / "scene.xml").write_text(text)
    assert len(rt.load_file(folder / "scene.xml").description.shapes) == 1


def test_a_comment_may_hold_any_bytes(tmp_path: Path) -> None:
    (tmp_path / "scene.xml").write_bytes(b'<scene version="3.0.0"><!-- Andr\xe9 --><shape type="sphere"/></scene>')
    assert len(rt.load_file(tmp_path / "scene.xml").description.shapes) == 1
