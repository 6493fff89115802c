"""Files that are damaged, hostile or of another kind: every reader ends with one line that begins
with the name of the file.
"""

import json
import time
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
import safetensors.numpy

import worlds
from applr_ros1 import robots
from applr_ros1.common import files
from applr_ros1.common.errors import LONGEST_VALUE, ApplrError, shown
from applr_ros1.policy import actor, methods
from applr_ros1.policy.parameter_space import THETA_0
from applr_ros1.robots import parameter_files
from tests.support import scenes
from tests.support.damages import named_pipe, written
from tests.support.refusals import refused
from tests.support.robots import make_weights

POLICY = "policy.safetensors"
CLASSIFIER = "contexts.safetensors"
SET = "set.json"
MAP = "office.yaml"
IMAGE = "office.pgm"
POSTSCRIPT = "%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 60 60\n%%EndComments\nshowpage\n%%EOF\n"
WORLD = "world_7.world"
CELLS = "path_files/path_7.npy"
MOVERS = "movers.csv"
ROBOT = "robot.yaml"
PARAMETERS = "parameters.yaml"

# Processor time in which a file is refused: ten times that of the slowest case [s]
LONGEST_S = 5.0
# A YAML value that stands for 10^9 letters
BOMB = ["&a [x, x, x, x, x, x, x, x, x, x]"]
for _anchor, _alias in zip("bcdefghi", "abcdefgh"):
    _aliases = ", ".join([f"*{_alias}"] * 10)
    BOMB.append(f"&{_anchor} [{_aliases}]")
BOMB_TEXT = f"[{', '.join(BOMB)}]"


@pytest.fixture
def whole(tmp_path):
    """Provide a folder with a whole file of each kind."""
    contexts = {"open": THETA_0[:8], "tight": THETA_0[:8]}
    actor.save(tmp_path / POLICY, make_weights())
    actor.save_contexts(tmp_path / CLASSIFIER, contexts, make_weights(inputs=720, outputs=2))
    (tmp_path / SET).write_text('{"max_vel_x": 1.5}')
    scenes.write_plan(tmp_path, "office")
    world = worlds.load("generated:7")
    _, cells = worlds.barn.fields()[7]
    scenes.write_world(tmp_path, scenes.as_barn(world), cells=cells)
    (tmp_path / MOVERS).write_text("plugin,length,repeat,time,x,y\na,1,1,0,0,0\n")
    (tmp_path / PARAMETERS).write_text("controller_frequency: 10.0\n")
    return tmp_path


READERS = {
    POLICY: actor.load,
    CLASSIFIER: actor.load,
    SET: lambda path: methods.make(str(path)),
    MAP: lambda path: worlds.load(f"{path}:0"),
    IMAGE: lambda path: worlds.load(f"{path.with_suffix('.yaml')}:0"),
    WORLD: lambda path: worlds.load(str(path)),
    CELLS: lambda path: worlds.load(str(path.parents[1] / WORLD)),
    MOVERS: lambda path: worlds.dynabarn.read_table(str(path)),
    ROBOT: lambda path: robots.load(str(path.parent)),
    PARAMETERS: parameter_files.nested,
}


# -- damages: functions of a path
def cut(path):
    """Keep the first half of a file."""
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])


def other_byte(text, damaged_text):
    """Return the damage of a file in which one text is another one of the same length."""

    def damage(path):
        content = path.read_bytes()
        assert text in content
        path.write_bytes(content.replace(text, damaged_text, 1))

    return damage


def with_tensor(name, change):
    """Return the damage of a policy in which a tensor is changed."""

    def damage(path):
        content = path.read_bytes()
        header_length = int.from_bytes(content[:8], "little")
        metadata = json.loads(content[8 : 8 + header_length])["__metadata__"]
        tensors = safetensors.numpy.load(content)
        tensors[name] = np.ascontiguousarray(change(tensors[name]))
        path.write_bytes(safetensors.numpy.save(tensors, metadata=metadata))

    return damage


def one_value(value):
    """Return the change of a tensor in which one number is another one."""

    def change(tensor):
        changed_tensor = tensor.copy()
        changed_tensor.flat[5] = value
        return changed_tensor

    return change


def object_array(path):
    """Write an array of objects, which numpy would unpickle."""
    np.save(path, np.array([{}, {}], dtype=object), allow_pickle=True)


def map_with(field, value):
    """Return the damage of a map with another value of a field."""
    return lambda path: scenes.write_plan(path.parent, "office", **{field: value})


DAMAGES = [
    # Numbers with which a network cannot decide
    (POLICY, with_tensor("1.weight", one_value(np.nan)), "tensor 1.weight has NaN or infinite"),
    (POLICY, with_tensor("2.bias", one_value(-np.inf)), "tensor 2.bias has NaN or infinite"),
    (POLICY, with_tensor("0.weight", lambda tensor: tensor.astype(np.int64)), "0.weight is int64"),
    (POLICY, with_tensor("0.weight", lambda tensor: tensor.astype(np.float16)), "is float16"),
    (POLICY, with_tensor("1.weight", lambda tensor: tensor[:, :7]), "damaged"),
    (CLASSIFIER, with_tensor("0.bias", one_value(np.nan)), "tensor 0.bias has NaN or infinite"),
    (CLASSIFIER, with_tensor("0.bias", lambda tensor: tensor.astype(np.int32)), "0.bias is int32"),
    # A wrong byte in the header: a name, a JSON value, the length, the data
    (POLICY, other_byte(b'"space"', b'"spacf"'), "cannot be read; "),
    (POLICY, other_byte(b'\\"names\\": [', b'\\"names\\": {'), "line 1, column"),
    (POLICY, other_byte(b'"0.weight"', b'"9.weight"'), "cannot be read; "),
    (POLICY, other_byte(b'"F32"', b'"F99"'), "damaged"),
    (CLASSIFIER, other_byte(b'"contexts"', b'"contextz"'), "cannot be read; "),
    (POLICY, cut, "damaged"),
    # Files of other kinds
    (SET, written("[1, 2]"), "damaged"),
    (SET, written("[" * 20_000), "damaged"),
    (SET, written('{"max_vel_x": 9e99999}'), "max_vel_x is inf: give"),
    (IMAGE, cut, "damaged"),
    (IMAGE, written("text"), "damaged"),
    (
        IMAGE,
        written("P5 5000 4001 255\n"),
        "20.0 million cells, and at most 20 million",
    ),
    (IMAGE, written("P5 20768 13612 255\n"), "the map has 282.7 million cells.*: cut it to the"),
    # Pillow would have Ghostscript run it.
    (IMAGE, written(POSTSCRIPT), "the image is of the kind EPS: save it as PGM or PNG"),
    (IMAGE, written("P5 5000 4000 255\n"), "damaged"),
    (WORLD, written("<sdf><world>"), "give a Gazebo world file"),
    (CELLS, object_array, "damaged"),
    (CELLS, lambda path: np.save(path, np.zeros(3)), "damaged"),
    (MOVERS, written("plugin,length\na,1\n"), "cannot be read; "),
    (PARAMETERS, written("- a\n"), "contains no mapping"),
    # Values too large or too deep
    (MAP, map_with("image", BOMB_TEXT), "more than 100000 values"),
    (MAP, map_with("image", "[" * 20_000), "more than 50 levels"),
    (MAP, written("image: &a [*a]"), "an alias inside its own anchor"),
    (ROBOT, written(f"base: {BOMB_TEXT}"), "more than 100000 values"),
    (ROBOT, written("- " * 20_000), "more than 50 levels"),
    (PARAMETERS, written(f"DWAPlannerROS: {BOMB_TEXT}"), "more than 100000 values"),
    # Pipes, whose reading would not end
    *((file_name, named_pipe, "a pipe or device; give the path") for file_name in READERS),
]


@pytest.mark.parametrize(("file_name", "damage", "problem"), DAMAGES)
def test_a_damaged_file_is_one_line_that_begins_with_its_name(file_name, damage, problem, whole):
    damaged_file = whole / file_name
    damage(damaged_file)
    worlds.dynabarn.read_table.cache_clear()
    robots.folder.forget()
    begin = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        line = refused(lambda: READERS[file_name](damaged_file), problem)
    assert line.startswith(f"{damaged_file}: ")
    assert line.count(str(damaged_file)) == 1
    assert len(line) < len(str(damaged_file)) + 400
    assert time.process_time() - begin < LONGEST_S


def test_whole_files_are_read(whole):
    for file_name, read in READERS.items():
        if file_name != ROBOT:
            assert read(whole / file_name)


# -- the rule
def test_any_error_of_a_reader_is_one_of_the_innermost_file():
    for error in (KeyError("names"), RuntimeError("LZ4F\nframe"), OSError("Invalid data stream")):
        outer_file = files.reading("outer.yaml")
        inner_file = files.reading("inner.pgm", "copy it again")
        with pytest.raises(files.FileError) as raised, outer_file, inner_file:
            raise error
        # The class of the error means nothing to the owner of the file.
        assert str(raised.value) == "inner.pgm: cannot be read; copy it again"
        assert raised.value.__cause__ is error


def test_interruptions_lack_of_memory_and_missing_packages_are_no_errors_of_a_file():
    for error in (KeyboardInterrupt, MemoryError, ModuleNotFoundError):
        with pytest.raises(error), files.reading("a.bag"):
            raise error


def test_an_error_of_a_reader_is_found_with_its_traceback_on_request(capsys, monkeypatch):
    monkeypatch.setenv("APPLR_DEBUG", "1")
    with pytest.raises(ApplrError), files.reading("a.bag"):
        SimpleNamespace().stamp  # noqa: B018
    assert "SimpleNamespace().stamp" in capsys.readouterr().err


def test_aliases_and_merges_of_parameter_files_are_read():
    text = "a: &a {x: 1, y: [1, 2]}\nb: {<<: *a, x: 2}\nc: [*a, *a]\n"
    value = files.yaml_value(text, "a.yaml")
    assert value["b"] == {"x": 2, "y": [1, 2]}
    assert value["c"] == [value["a"], value["a"]]


def test_a_value_is_shown_shortened():
    assert shown("omni") == "'omni'"
    assert shown([0.1, -0.2, 3]) == "[0.1, -0.2, 3]"
    for huge_value in ("x" * 10**6, list(range(10**6)), [["x" * 99] * 99] * 99):
        assert len(shown(huge_value)) <= LONGEST_VALUE + len("...")
