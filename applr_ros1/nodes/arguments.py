"""The launch file's arguments: read from ARG:=VALUE words, and checked before any node starts.

Called by scripts/check_arguments.py (while roslaunch loads the file) and by the demo. Names, defaults and sentences
stand in launch/jackal_applr.launch; what a value may be stands here.
"""

import math
import os
import re
import sys
import xml.etree.ElementTree as xml

import sim_bridge
import worlds
from applr_ros1.common.arguments import check_new_bag
from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.planner.variant import DRAWN, WEIGHTS
from applr_ros1.policy import methods
from applr_ros1.policy.distance_weights import CHOICES
from applr_ros1.robots import NAMES, load

from . import mode_files

MAX_GOAL = 1e5  # m; farther than any costmap
MOVE_BASES = ("python", "cpp")
SEPARATOR = "\u241f"  # between arguments in the launch file's one word
ROS_NAME = re.compile(r"^/?[A-Za-z]\w*(/\w+)*$", re.ASCII)
PARAMETER_FILES = (
    "move_base_params.yaml",
    "base_local_planner_params.yaml",
    "costmap_common_params.yaml",
    "odom_nav_params/global_costmap_params.yaml",
    "odom_nav_params/local_costmap_params.yaml",
)
USED_BY = {"policy": ("applr", "appld"), "parameters": ("fixed",)}  # the modes that read the file
REPLACED = {  # the names in a robot's topics, and those of them that the launch file can replace by another
    "scan_topic": ("scan", ("front/scan", "scan")),
    "odom_topic": ("odometry", ("odometry/filtered", "odom")),
    "cmd_vel_topic": ("cmd_vel", ("cmd_vel",)),
}


class ArgumentError(ApplrError):
    """An argument that the stack cannot start with; one line: what, which value, what to give."""


def launch_file():
    """Path of jackal_applr.launch, the same below the package's folder in devel and in install space."""
    import rospkg

    return os.path.join(rospkg.RosPack().get_path("applr_ros1"), "applr_ros1", "launch", "jackal_applr.launch")


def declared(path=None):
    """{name: (default, doc)} of the launch file's arguments, in its order."""
    root = xml.parse(path or launch_file()).getroot()
    return {
        arg.get("name"): (arg.get("default"), arg.get("doc", ""))
        for arg in root.findall("arg")
        if arg.get("value") is None
    }


def parse(words, known):
    """{name: value} from ["name:=value", ...].

    ArgumentError for other words, unknown names and repeated ones, and for line breaks.
    """
    given = {}
    for word in words:
        name, separator, value = word.partition(":=")
        if not separator or not name:
            raise ArgumentError("%s: arguments are given as ARG:=VALUE, for instance world:=generated:7" % word)
        if name.startswith("_"):  # roslaunch's and ROS's own
            continue
        _check_name(name, known)
        if name in given:
            raise ArgumentError("%s:= is given twice: give it once" % name)
        if "\n" in value:  # roslaunch would leave it out without a word
            raise ArgumentError("%s is %s: ROS takes no line break in an argument; rename the file" % (name, value))
        given[name] = value
    return given


def _check_name(name, known):
    if name not in known:
        raise ArgumentError("%s:= is no argument: there are %s" % (name, ", ".join(known)))


def check(values):
    """Raise ArgumentError, WorldError, SpaceError, ActorError or AppldError, of one line, if the stack cannot start so.

    values: {name: text} for every argument of the launch file.
    """
    sim = boolean("sim", values["sim"])
    robot = load(values["robot"])
    boolean("gazebo", values["gazebo"])
    boolean("gui", values["gui"])
    boolean("rviz", values["rviz"])
    boolean("record_costmaps", values["record_costmaps"])
    boolean("monitor", values["monitor"])
    _simulator(values["simulator"])
    one_of("move_base", values["move_base"], MOVE_BASES)
    with_map = boolean("map", values["map"])
    if values["move_base"] == "python":  # a move_base that runs already has its own files
        robot.parameters(with_map)  # some have none for a map
    one_of("planner_weights", values["planner_weights"], WEIGHTS + (DRAWN,))
    if values["weights"] in WEIGHTS + (DRAWN,):
        raise ArgumentError("weights is %s: what the Python move_base does is planner_weights now" % values["weights"])
    one_of("weights", values["weights"], CHOICES)
    factor = number("real_time_factor", values["real_time_factor"])
    if factor < 0:
        raise ArgumentError("real_time_factor is %g: give 0 (as fast as it goes) or more" % factor)
    whole("seed", values["seed"], 0, 2**31 - 1)
    mode = mode_files.absolute(usable_mode(values, robot))
    methods.make_mode(mode, path(values["policy"]), path(values["parameters"]), robot)
    for name, modes in USED_BY.items():
        if path(values[name]) and mode not in modes:
            told = name, values[name], values["mode"], " or mode:=".join(modes), name
            raise ArgumentError("%s is %s: mode %s does not use it; give mode:=%s, or leave %s:= away" % told)
    goal(values["goal"])
    _interface(values, robot)
    _topics(values, robot)
    if sim:
        worlds.load(values["world"])
    recording(values["record"])


def usable_mode(values, robot):
    """The argument `mode`, or dwa where that is applr and the robot has no policy of its own and is given none.

    The applr node then drives on the robot's own parameters, too, and says so.
    """
    missing = values["policy"] == "shipped" and not os.path.isfile(methods.shipped(robot=robot))
    return "dwa" if values["mode"] == "applr" and missing else values["mode"]


def _simulator(text):
    """One of the included simulators, or a class of a person's own that the simulator's node finds, too."""
    if not sim_bridge.is_name(text):
        one_of("simulator", text, sim_bridge.NAMES)
    if text not in sim_bridge.NAMES:
        module, _, kind = text.rpartition(":")
        if mode_files.from_the_root(module) != module and not module.endswith(".py"):
            file = module.replace(".", "/") + ".py"
            raise ArgumentError("simulator is %s: its node runs in another folder; give %s:%s" % (text, file, kind))
        sim_bridge.find(text)


def _interface(values, robot):
    """The arguments that fit the stack to a robot: parameter files, names, the cap on its speed."""
    folder = path(values["params"])
    if folder and values["robot"] != "jackal":
        raise ArgumentError("params is %s: for robot %s its own folder has the files" % (folder, robot.name))
    for file in PARAMETER_FILES if folder else ():
        if not os.path.isfile(os.path.join(folder, file)):
            raise ArgumentError(
                "params is %s: it has no file %s; copy the package's folder and edit it" % (folder, file)
            )
    if values["max_speed"] != "none":
        bounds = [(p.low, p.high) for p in robot.space if p.name == "max_vel_x"]
        if not bounds:
            told = values["max_speed"], robot.name
            raise ArgumentError("max_speed is %s: robot %s has no parameter max_vel_x to cap; give none" % told)
        if not bounds[0][0] <= number("max_speed", values["max_speed"]) <= bounds[0][1]:
            raise ArgumentError("max_speed is %s: give %g to %g m/s, or none" % (values["max_speed"], *bounds[0]))
    computers = values["use_sim_time"] != "auto" and not boolean("use_sim_time", values["use_sim_time"])
    if computers and boolean("sim", values["sim"]):
        raise ArgumentError("use_sim_time is false: a simulated robot's time is that of /clock; leave it away")
    pose("start", values["start"])
    boolean("clock", values["clock"])
    for name in values["others"].split() or ("",):
        if not ROS_NAME.match(name):
            raise ArgumentError("others is %s: give namespaces such as '/robot2 /robot3', or none" % values["others"])
    for name in ("tf_prefix", "scan_topic", "odom_topic", "cmd_vel_topic", "odom_frame", "base_frame"):
        if not ROS_NAME.match(values[name]):
            raise ArgumentError("%s is %s: give a name such as front/scan" % (name, values[name] or "empty"))


def _topics(values, robot):
    """The arguments that replace names of topics: they reach a robot only whose description has the usual names."""
    for name, (field, usual) in REPLACED.items():
        own = getattr(robot.topics, field)
        if own.lstrip("/") not in usual and values[name].lstrip("/") not in ("auto", own.lstrip("/")):
            told = name, values[name], robot.name, own, field
            raise ArgumentError("%s is %s: robot %s has %s; change topics.%s in its robot.yaml instead" % told)
    own, ours = robot.topics.cmd_vel, values["move_base"] == "python" and not boolean("monitor", values["monitor"])
    if ours and own.lstrip("/") != "cmd_vel" and values["cmd_vel_topic"] == "auto":
        told = robot.name, own, own
        raise ArgumentError("monitor is false: move_base commands cmd_vel, robot %s %s; add cmd_vel_topic:=%s" % told)


def boolean(name, text):
    """True or False from a launch file's spelling."""
    if str(text).lower() not in ("true", "false", "1", "0"):
        raise ArgumentError("%s is %s: give true or false" % (name, text or "empty"))
    return str(text).lower() in ("true", "1")


def one_of(name, text, choices):
    """ArgumentError unless the argument `name` has one of the values `choices`."""
    if text not in choices:
        raise ArgumentError("%s is %s: give %s" % (name, text or "empty", " or ".join(choices)))


def number(name, text):
    """A finite float."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ArgumentError("%s is %s: give a number" % (name, text or "empty"))
    return value


def whole(name, text, low, high):
    """A whole number from `low` to `high`, in decimal digits: roslaunch takes no other spelling."""
    if not re.fullmatch("[0-9]{1,10}", text) or not low <= int(text) <= high:
        raise ArgumentError("%s is %s: give a whole number from %d to %d" % (name, text or "empty", low, high))
    return int(text)


def goal(text):
    """None for auto and none, else (x, y, yaw) [m, m, rad] in the frame of the odometry."""
    return None if text == "none" else pose("goal", text, "auto, none")


def pose(name, text, others="auto"):
    """None for auto, else (x, y, yaw) [m, m, rad] of the argument `name`; others: what it may be instead."""
    if text == "auto":
        return None
    words = str(text).replace(",", " ").split()
    if len(words) != 3:
        raise ArgumentError(
            "%s is %s: give %s, or three numbers 'x y yaw' in metres and radians" % (name, text or "empty", others)
        )
    values = tuple(number(name, word) for word in words)
    if max(map(abs, values)) > MAX_GOAL:
        raise ArgumentError("%s is %s: give numbers from %g to %g" % (name, text, -MAX_GOAL, MAX_GOAL))
    return values


def path(text):
    """A file argument; the words that stand for no file become ''."""
    return "" if text in ("none", "shipped") else text


def recording(text):
    """ArgumentError if the argument `record` names a file that is there or cannot be written; none records nothing."""
    if not path(text):
        return
    folder = os.path.dirname(os.path.abspath(text))
    if not text.endswith(".bag"):
        raise ArgumentError("record is %s: give the path of a file that ends in .bag" % text)
    if os.path.lexists(text) and not os.path.isfile(text):
        raise ArgumentError("record is %s: a folder, pipe or device; give the path of a regular file" % text)
    check_new_bag(text, ArgumentError)
    if not os.path.isdir(folder) or not os.access(folder, os.W_OK):
        raise ArgumentError("record is %s: its folder %s is not there or not writable" % (text, folder))


def main():
    """The command check_arguments.py: prints "checked", or one line about the argument that is wrong."""
    return run_main(_check_for_roslaunch if sys.argv[1:2] == ["--hex"] else _check_command_line, "applr")


def _check_command_line():
    _checked([word for word in sys.argv[1:] if not word.startswith("_")])
    print("checked")


def _check_for_roslaunch():
    """The launch file's current folder and all arguments, whatever quotes they hold, as one hexadecimal word.

    Prints the mode with absolute paths.
    """
    here, *words = [word.lstrip() for word in bytes.fromhex(sys.argv[2]).decode("utf-8").split(SEPARATOR)]
    with os.fdopen(os.dup(1), "w", encoding="utf-8", errors="surrogateescape") as answer:
        os.dup2(2, 1)  # what a method of one's own prints is no part of the answer
        with open("/proc/%d/cmdline" % os.getppid(), encoding="utf-8", errors="surrogateescape") as file:
            _check_names(file.read().split("\0"))
        values = _checked(words)
        _check_folder(here, values)
        answer.write(mode_files.absolute(values["mode"]))


def _check_names(command_line):
    """ArgumentError for an argument of roslaunch's command line that its only launch file, ours, does not have.

    roslaunch itself passes over it without a word.
    """
    files = [place for place, word in enumerate(command_line) if word.endswith(".launch")]
    if len(files) != 1:
        return
    before, file = command_line[files[0] - 1], command_line[files[0]]
    path_of_ours = os.path.isfile(file) and os.path.samefile(file, launch_file())
    if path_of_ours or (before, file) == ("applr_ros1", os.path.basename(launch_file())):
        known = declared()
        for name in (word.partition(":=")[0] for word in command_line if ":=" in word):
            if not name.startswith("_"):  # ROS's own
                _check_name(name, known)


def _check_folder(here, values):
    """ArgumentError where a file is given from the current folder, and the launch file has another one for that.

    It knows the current folder from the variable PWD alone, which shells keep; a service of systemd has none, and a
    program that starts roslaunch in another folder may leave its own.
    """
    if os.path.isdir(here) and os.path.samefile(here, "."):
        return
    for name in ("robot", "world", "policy", "parameters", "record", "simulator"):
        text = path(values[name]).rpartition(":")[0] if name == "simulator" else path(values[name])
        is_file = text not in (*NAMES, "", "published") and (name != "world" or text.endswith(".world"))
        if is_file and not os.path.isabs(text) and (name == "record" or os.path.exists(text)):
            told = name, text, here.rstrip("/") or "not set", os.getcwd()
            raise ArgumentError("%s is %s: PWD is %s and the current folder is %s; give the path from the root" % told)


def _checked(words):
    """{name: text} of all arguments, after `check`."""
    known = declared()
    values = dict({name: default for name, (default, _) in known.items()}, **parse(words, known))
    check(values)
    return values
