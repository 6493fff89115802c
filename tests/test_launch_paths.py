"""Paths with quotes and spaces in arguments of the launch files, line breaks, which ROS does not take, and the lists of
arguments."""

import json
import os
import re
import shutil

import pytest
from test_launch import ROOT, inside

import worlds
from applr_ros1.nodes import arguments
from worlds import sdf_writer

pytestmark = pytest.mark.ros

LOAD = """
import json, shlex, sys
import roslaunch.config, roslaunch.xmlloader
config = roslaunch.config.ROSLaunchConfig()
roslaunch.xmlloader.XmlLoader().load(sys.argv[1], config, argv=sys.argv[2:], verbose=False)
print(json.dumps({
    "parameters": {name: param.value for name, param in config.params.items()},
    "words": {node.name: shlex.split(node.args or "") for node in config.nodes},
}))
"""


def test_quotes_and_spaces_in_paths_reach_the_nodes_as_they_are(tmp_path):
    folder = tmp_path / 'it\'s a "b" c'
    shutil.copytree(os.path.join(ROOT, "applr_ros1", "robots", "jackal"), folder / "robot")
    world = folder / "w.world"
    sdf_writer.write(worlds.load("generated:1"), str(world))
    given = {"robot": folder / "robot", "world": world, "record": folder / "r.bag", "rviz": "true"}
    words = ["%s:=%s" % pair for pair in given.items()]
    done = inside("python", "-c", LOAD, os.path.join(ROOT, "applr_ros1", "launch", "jackal_applr.launch"), *words)
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["parameters"]["/applr/mode"] == "applr"
    for node in ("sim_bridge", "move_base", "collision_monitor", "applr", "send_goal"):
        assert found["parameters"]["/%s/robot" % node] == str(folder / "robot")
    assert found["parameters"]["/sim_bridge/world"] == str(world)
    assert found["words"]["record"] == [str(folder / "r.bag"), "--costmaps", "false", "--robot", str(folder / "robot")]
    assert found["words"]["rviz"][:2] == ["--robot", str(folder / "robot")]
    bag = ["bag:=%s" % (folder / "r.bag"), "robot:=%s" % (folder / "robot")]
    done = inside("python", "-c", LOAD, os.path.join(ROOT, "applr_ros1", "launch", "replay.launch"), *bag)
    assert done.returncode == 0, done.stderr[-2000:]
    assert json.loads(done.stdout.splitlines()[-1])["words"]["replay"][0] == str(folder / "r.bag")


def test_files_given_from_the_current_folder_reach_the_nodes_that_run_in_another(tmp_path):
    models = os.path.join(ROOT, "applr_ros1", "models")
    shutil.copy(os.path.join(models, "applr_start.safetensors"), tmp_path / "mine.safetensors")
    shutil.copy(os.path.join(models, "static.json"), tmp_path / "set.json")
    sdf_writer.write(worlds.load("generated:1"), str(tmp_path / "w.world"))
    (tmp_path / "own.py").write_text(
        "print('loaded')\n\n\nclass Own:\n    def theta(self, context):\n        return context.theta\n"
    )
    shutil.copytree(os.path.join(ROOT, "applr_ros1", "robots", "jackal"), tmp_path / "mine")
    launch = os.path.join(ROOT, "applr_ros1", "launch", "jackal_applr.launch")

    def found(*words):
        done = inside("python", "-c", LOAD, launch, *words, cwd=str(tmp_path))
        assert done.returncode == 0, done.stderr[-2000:]
        return json.loads(done.stdout.splitlines()[-1])["parameters"]

    given = found("policy:=mine.safetensors", "mode:=applr")
    assert given["/applr/policy"] == str(tmp_path / "mine.safetensors")
    given = found("parameters:=set.json", "mode:=fixed")
    assert given["/applr/parameters"] == str(tmp_path / "set.json")
    (tmp_path / "sim.py").write_text("from sim_bridge.kinematic_simulator import KinematicSimulator as Sim\n")
    words = "robot:=mine", "world:=w.world", "mode:=period:1:own.py:Own", "rviz:=true", "simulator:=sim.py:Sim"
    given = found(*words)
    assert given["/sim_bridge/simulator"] == str(tmp_path / "sim.py") + ":Sim"
    assert given["/applr/mode"] == "period:1:" + str(tmp_path / "own.py") + ":Own"
    for node in ("sim_bridge", "move_base", "collision_monitor", "applr", "send_goal", "parameter_panel"):
        assert given["/%s/robot" % node] == str(tmp_path / "mine")
    assert given["/sim_bridge/world"] == given["/send_goal/world"] == str(tmp_path / "w.world")
    names = found("mode:=appld", "policy:=published")
    assert (names["/applr/policy"], names["/applr/parameters"]) == ("published", "")
    assert (names["/applr/mode"], names["/sim_bridge/world"]) == ("appld", "generated:0")


def test_a_line_break_in_an_argument_is_refused():
    """ROS leaves such an argument out without a word, and the stack would drive something else."""
    with pytest.raises(arguments.ArgumentError, match="no line break"):
        arguments.parse(["world:=a\nb.world"], arguments.declared())


def test_a_current_folder_that_the_launch_file_has_wrong_is_no_place_for_files(tmp_path):
    """It is the shell's variable PWD, which a service lacks and a program may leave as it was for itself."""
    sdf_writer.write(worlds.load("generated:1"), str(tmp_path / "w.world"))
    launch = os.path.join(ROOT, "applr_ros1", "launch", "jackal_applr.launch")

    def loaded(*words, told="PWD=/usr"):
        return inside("env", *told.split(), "python", "-c", LOAD, launch, *words, cwd=str(tmp_path))

    line = "applr: world is w.world: PWD is %%s and the current folder is %s; give the path from the root" % tmp_path
    assert line % "/usr" in loaded("world:=w.world").stderr.splitlines()
    assert line % "not set" in loaded("world:=w.world", told="-u PWD").stderr.splitlines()
    assert "record is a.bag: PWD is /usr and" in loaded("record:=a.bag").stderr
    assert loaded("world:=%s" % (tmp_path / "w.world")).returncode == loaded("world:=generated:1").returncode == 0


@pytest.mark.parametrize(
    ("name", "required"),
    [
        ("jackal_applr", []),
        ("replay", ["bag"]),
        ("two_jackals", []),
        ("velocity_method", ["method"]),
        ("barn_controller", []),
    ],
)
def test_roslaunch_lists_the_arguments_of_a_launch_file(name, required):
    listed = inside("roslaunch", "--ros-args", "applr_ros1", name + ".launch")
    assert listed.returncode == 0, listed.stderr
    needed, _, others = listed.stdout.rpartition("Optional Arguments:")
    assert re.findall(r"^  (\w+)", needed, re.MULTILINE) == required
    path = os.path.join(ROOT, "applr_ros1", "launch", name + ".launch")
    assert {*re.findall(r"^  (\w+)", others, re.MULTILINE), *required} == set(arguments.declared(path))
    assert "undocumented" not in listed.stdout
