"""Tests that world files that are missing, malformed, hostile or impassable give a message and
execute no code.
"""

import os

import numpy as np
import pytest

import worlds
from tests.support.refusals import refused as refused_call
from tests.support.scenes import as_barn, cylinder, sdf, write_world
from tests.support.scenes import refused_world as refused
from worlds import barn, sdf_writer

EXTERNAL = (
    "<!DOCTYPE sdf [<!ENTITY x SYSTEM 'file:///etc/passwd'>]>"
    "<sdf><world name='w'><model name='&x;'/></world></sdf>"
)


@pytest.mark.fault("22")
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["cannot be read", "give a Gazebo world file"]),
        ("<html></html>", ["contains no <world>"]),
        (EXTERNAL, ["without DOCTYPE"]),
        (sdf(cylinder(float("nan"), 0)), ["unit_cylinder_0", "nan", "finite"]),
        (sdf(cylinder(0, 0), ""), ["has no course", "--course X Y X Y"]),
    ],
)
def test_invalid_world_files_are_one_line(tmp_path, text, words):
    refused(write_world(tmp_path, text, "w.world"), *words)


def test_missing_files_and_folders_are_one_line(tmp_path):
    refused(tmp_path / "missing.world", "missing.world", "give an existing file")
    (tmp_path / "folder.world").mkdir()
    refused(tmp_path / "folder.world", "Is a directory")
    (tmp_path / "empty").mkdir()
    refused_call(lambda: worlds.Worlds(str(tmp_path / "empty")), "contains no .world files")


def test_sealed_worlds_have_no_passage(tmp_path):
    world = worlds.load("generated:7")
    _, path = barn.fields()[7]
    # A row of 30 cylinders across the field
    seal = ""
    for column in range(30):
        seal += cylinder(-4.425 + 0.15 * column, 7.425, name=f"seal_{column}")
    sealed_world = as_barn(world).replace("</world>", seal + "</world>")
    refused(write_world(tmp_path, sealed_world, cells=path), "no passage")


class Evil:
    """Object whose pickle makes a file when it is read."""

    def __reduce__(self):
        return os.system, ("touch evil-was-here",)


def test_a_pickle_in_place_of_a_path_is_not_loaded(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    # numpy would unpickle an array of objects if it were allowed to.
    cells = np.array([Evil(), Evil()], dtype=object)
    text = as_barn(worlds.load("generated:7"))
    world_file = write_world(tmp_path, text, cells=cells)
    refused(world_file, "path_7.npy: cannot be read")
    assert not os.path.exists("evil-was-here")


def test_an_invalid_course_in_a_file_is_one_line(tmp_path):
    text = sdf_writer.text(worlds.load("generated:7"))
    # A wrong number is added to each element.
    for tag, wrong_element, field in (
        ("<applr:start>", "<applr:start>nan ", "start"),
        ("<applr:goal>", "<applr:goal>x ", "goal"),
        ("<applr:path>", "<applr:path>1 ", "path"),
    ):
        wrong_text = text.replace(tag, wrong_element)
        refused(write_world(tmp_path, wrong_text, "w.world"), field)
