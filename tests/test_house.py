"""The house's own rules: who may know whom, Python 3.8 on the robot's side, documented arguments, exact requirements,
declared dependencies, run bits, and nothing of other people's machines in the repo. Reads files only; needs no ROS.
"""

import ast
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as xml
from functools import lru_cache

import pytest
import yaml

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
ROBOT_SIDE = ("applr_ros1", "sim_bridge", "worlds")
PACKAGES = ROBOT_SIDE + ("training",)
BUILTIN_GENERICS = ("list", "dict", "tuple", "set", "frozenset", "type")
STANDARD = set(getattr(sys, "stdlib_module_names", ())) | {"__future__"}
ROS = {
    "rospy",
    "rosgraph",
    "roslib",
    "rosbag",
    "rospkg",
    "actionlib",
    "actionlib_msgs",
    "dynamic_reconfigure",
    "tf2_ros",
    "tf2_msgs",
    "geometry_msgs",
    "nav_msgs",
    "sensor_msgs",
    "std_msgs",
    "std_srvs",
    "map_msgs",
    "move_base_msgs",
    "diagnostic_msgs",
    "visualization_msgs",
    "rosgraph_msgs",
    "genpy",
}
NUMBERS = {"numpy", "numba", "torch"}
LEARNING = NUMBERS | {
    "scipy",
    "matplotlib",
    "gymnasium",
    "ray",
    "tensorboard",
    "cma",
    "ruptures",
    "sklearn",
    "rosbags",
    "onnx",
    "onnxruntime",
    "onnxscript",
    "safetensors",
    "stable_baselines3",
    "minari",
    "h5py",
    "tqdm",
    "yaml",
}
SHARED = {"applr_ros1.common"}  # what every package may import
# first match wins: folder or file -> modules that it may import beside the standard library, SHARED and itself
MAY_KNOW = (
    ("applr_ros1/common/ros_shutdown", {"rospy"}),  # for the nodes and the bridge
    ("applr_ros1/common/", {"numpy", "numba", "safetensors"}),
    ("worlds/", {"numpy", "scipy", "defusedxml", "matplotlib", "PIL", "capstone"}),
    ("applr_ros1/planner/", NUMBERS | {"dynamic_reconfigure"}),  # the latter when catkin runs cfg_generator.py
    ("applr_ros1/monitor/", NUMBERS | {"scipy", "applr_ros1.planner", "applr_ros1.robots"}),
    ("applr_ros1/policy/", NUMBERS | {"safetensors", "scipy", "applr_ros1.planner", "applr_ros1.robots"}),
    ("applr_ros1/robots/", {"yaml"}),
    ("applr_ros1/nodes/", None),
    ("applr_ros1/scripts/", None),
    ("applr_ros1/", {"gymnasium"}),
    ("sim_bridge/gazebo/", None),
    ("sim_bridge/ros_", None),
    ("sim_bridge/", NUMBERS | {"scipy", "pybullet", "pybullet_utils", "matplotlib", "worlds", "applr_ros1.robots"}),
    ("training/td3/", {"numpy", "torch"}),
    ("training/experience/", {"numpy", "safetensors", "training.storage"}),
    (
        "training/mdp/",
        {"numpy", "gymnasium", "applr_ros1.monitor", "applr_ros1.planner", "applr_ros1.policy", "applr_ros1.robots"}
        | {"sim_bridge", "worlds"},
    ),
    ("training/workers/", {"numpy", "ray", "applr_ros1.policy"}),
    (
        "training/evaluation/",
        {"numpy", "applr_ros1.monitor", "tqdm", "applr_ros1.planner", "applr_ros1.policy", "sim_bridge", "worlds"}
        | {"applr_ros1.robots", "training.mdp", "training.provenance", "training.storage", "training.workers"},
    ),
    (
        "training/report/",
        {"numpy", "scipy", "matplotlib", "worlds", "applr_ros1.policy", "training.evaluation", "training.provenance"}
        | {"applr_ros1.robots", "training.storage"},
    ),
    (
        "training/bags/",
        {"numpy", "lz4", "rosbags", "applr_ros1.policy", "applr_ros1.robots", "sim_bridge"}
        | {"training.experience", "training.mdp"},
    ),
    (
        "training/baselines/",
        {"numpy", "scipy", "torch", "cma", "ruptures", "sklearn", "applr_ros1.planner", "applr_ros1.policy"}
        | {
            "applr_ros1.robots",
            "sim_bridge",
            "worlds",
            "training.bags",
            "training.evaluation",
            "training.mdp",
            "training.workers",
        },
    ),
    (
        "training/refinement/",
        {"numpy", "safetensors", "applr_ros1.policy", "training.evaluation", "training.policy_file", "training.td3"}
        | {"training.workers"},
    ),
    (
        "training/gorila/",
        {"numpy", "torch", "tensorboard", "safetensors", "gymnasium", "matplotlib", "yaml", "applr_ros1.planner"}
        | {"applr_ros1.policy", "applr_ros1.robots", "sim_bridge", "worlds", "training.evaluation"}
        | {"training.experience", "training.mdp", "training.provenance"}
        | {"training.storage", "training.td3", "training.workers"},
    ),
    (
        "training/",
        LEARNING
        | {
            "applr_ros1.monitor",
            "applr_ros1.planner",
            "applr_ros1.policy",
            "applr_ros1.robots",
            "sim_bridge",
            "worlds",
        },
    ),
)


@lru_cache(maxsize=None)
def files():
    """Paths of the files in git (those new and not ignored too), relative to the root."""
    listed = subprocess.run(
        ["env", "git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        check=False,
    ).stdout.decode()
    return sorted(name for name in listed.split("\0") if name and os.path.isfile(os.path.join(ROOT, name)))


pytestmark = pytest.mark.skipif(not files(), reason="git lists no files: not a checkout, or not this user's")


def tracked(*suffixes):
    """Those of the files that end so; all without suffixes."""
    return [name for name in files() if not suffixes or name.endswith(suffixes)]


def python_files(folders):
    return [name for name in tracked(".py", ".cfg") if name.split("/")[0] in folders]


def text_of(name):
    with open(os.path.join(ROOT, name), encoding="utf-8") as file:
        return file.read()


def imports(name):
    """Full names of the modules that a file imports, relative ones resolved."""
    package = name.split("/")[:-1]
    found = []
    for node in ast.walk(ast.parse(text_of(name))):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else []
            base = ".".join(above + ([node.module] if node.module else []))
            found.append(base)
            if base in ("applr_ros1", "training", "worlds", "sim_bridge"):
                found += [base + "." + alias.name for alias in node.names]
    return found


@pytest.mark.parametrize("name", python_files(PACKAGES))
def test_who_may_know_whom(name):
    allowed = next(known for start, known in MAY_KNOW if name.startswith(start))
    if allowed is None:
        return
    own = next(start for start, _ in MAY_KNOW if name.startswith(start)).rstrip("/").replace("/", ".")
    for module in imports(name):
        parts = module.split(".")
        names = {".".join(parts[: i + 1]) for i in range(len(parts))}
        inside = own in names or module == "applr_ros1"
        assert inside or parts[0] in STANDARD or names & (allowed | SHARED), "%s imports %s" % (name, module)
        for nobody in ("applr_ros1.nodes", "applr_ros1.scripts"):
            assert nobody not in names or name.startswith(nobody.replace(".", "/")), "%s imports %s" % (name, module)


@pytest.mark.parametrize("name", python_files(ROBOT_SIDE))
def test_robot_side_parses_as_python_38(name):
    tree = ast.parse(text_of(name), filename=name, feature_version=(3, 8))
    future = any(isinstance(node, ast.ImportFrom) and node.module == "__future__" for node in tree.body)
    for node in ast.walk(tree):
        if type(node).__name__ == "Match":
            pytest.fail("%s:%d uses match" % (name, node.lineno))
        notes = [note for note in (getattr(node, "annotation", None), getattr(node, "returns", None)) if note]
        for note in [part for whole in notes if not future for part in ast.walk(whole)]:
            generic = isinstance(note, ast.Subscript) and getattr(note.value, "id", "") in BUILTIN_GENERICS
            new = generic or isinstance(note, ast.BinOp)
            assert not new, "%s:%d: this annotation needs from __future__ import annotations" % (name, note.lineno)


@pytest.mark.parametrize("name", python_files(PACKAGES + ("tests",)))
def test_files_of_one_thought(name):
    text = text_of(name)
    assert len(text.splitlines()) <= 430, "%s has %d lines" % (name, len(text.splitlines()))
    if text.strip():
        assert ast.get_docstring(ast.parse(text)), "%s does not say what it is for" % name


def test_every_launch_argument_is_documented():
    for name in tracked(".launch"):
        for argument in xml.parse(os.path.join(ROOT, name)).getroot().findall("arg"):
            assert argument.get("value") is not None or argument.get("doc"), "%s: %s" % (name, argument.get("name"))
    main = xml.parse(os.path.join(ROOT, "applr_ros1/launch/jackal_applr.launch")).getroot()
    pinned = {"world", "mode", "policy", "gui", "rviz", "seed", "record", "real_time_factor", "move_base", "sim"}
    assert pinned <= {argument.get("name") for argument in main.findall("arg")}


@pytest.mark.parametrize("name", [name for name in tracked(".txt") if name.startswith("requirements/")])
def test_requirements_are_exact(name):
    lines = [line for line in text_of(name).splitlines() if line.strip() and not line.startswith("#")]
    for line in lines:
        assert re.match(r"^[A-Za-z0-9._-]+==[A-Za-z0-9.]+( ; python_version [<>]=? \"3\.\d+\")?$", line), line
    assert len({line.split(" ;")[0].lower() for line in lines}) == len(lines)


def test_package_declares_what_it_imports():
    package = xml.parse(os.path.join(ROOT, "package.xml")).getroot()
    declared = {node.text for node in package if node.tag.endswith("depend")}
    used = {module.split(".")[0] for name in python_files(ROBOT_SIDE) for module in imports(name)} & ROS
    assert used - {"rospkg", "genpy"} <= declared, "package.xml lacks %s" % sorted(used - declared)


def test_only_what_a_person_starts_has_a_run_bit():
    runnable = {name for name in tracked() if os.access(os.path.join(ROOT, name), os.X_OK)}
    cfg = {name for name in tracked(".cfg")}  # catkin starts them itself
    assert runnable == {"applr", ".ci/run"} | cfg


def test_nothing_of_a_machine_or_a_registry():
    telling = re.compile(
        "|".join(
            [
                "pypi" + r"\.org",
                "pythonhosted" + r"\.org",
                "deb" + r"\.debian\.org",
                "/wo" + "rk/",
                "/ro" + "ot/",
                "/opt/" + "wheels",
                "/opt/" + "pypi",
            ]
        )
    )
    for name in tracked(
        ".py", ".md", ".txt", ".sh", ".launch", ".yaml", ".toml", ".xml", ".json", ".rviz", ".csv", "applr", ".ci/run"
    ):
        found = telling.search(text_of(name))
        assert not found, "%s names %s" % (name, found.group())


def test_sentences_of_reconfigurable_parameters_hold_no_quotes():
    """dynamic_reconfigure refuses them when catkin builds the package."""
    from applr_ros1.planner.parameters.declarations import SERVERS

    for parameters in SERVERS.values():
        for parameter in parameters:
            for text in [parameter.doc] + [text for _, _, text in parameter.enum]:
                assert not {"'", '"'} & set(text), "%s: %s" % (parameter.name, text)


def test_no_large_files():
    for name in tracked():
        size = os.path.getsize(os.path.join(ROOT, name))
        limit = 15_000_000 if name.startswith(("tests/golden/", "applr_ros1/models/")) else 1_500_000
        assert size <= limit, "%s has %d bytes" % (name, size)


def test_documents_hold_the_launch_arguments_and_the_parameters():
    from applr_ros1.planner.parameters.table import tables
    from applr_ros1.policy.parameter_space import SPACE

    assert tables() in text_of("docs/parameters.md"), "run: python -m applr_ros1.planner.parameters.table"
    readme = " ".join(text_of("README.md").split())
    for argument in xml.parse(os.path.join(ROOT, "applr_ros1/launch/jackal_applr.launch")).getroot().findall("arg"):
        if argument.get("value") is None:
            entry = "- `%s` (default `%s`): %s" % tuple(argument.get(name) for name in ("name", "default", "doc"))
            assert entry in readme, "README.md lacks the line " + entry
    for name, low, high, default in zip(SPACE.names, SPACE.low, SPACE.high, SPACE.theta0):
        entry = "| `%s` | %g | %g to %g |" % (name, default, low, high)
        assert entry in readme, "README.md lacks the row " + entry


def headings(page):
    """Headings of a Markdown file and the anchors that they have."""
    found = re.findall(r"^#+ (.+)$", text_of(page), re.MULTILINE)
    return found, {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in found}


def test_citations_of_the_documents_hold():
    """Each page of docs that a file cites exists, with the section or heading cited; nothing outside is cited."""
    section = r"\d+(?:\.\d+)*"
    citation = re.compile(r"\b(docs/[\w./]+\.md)(?:#([\w-]+)|,? sections? (%s)(?: to (%s))?)?" % (section, section))
    known = {os.path.basename(page) for page in tracked(".md")}
    for name in tracked(".py", ".cfg", ".md", ".launch", ".yaml", ".toml", ".cff", "applr"):
        text = re.sub(r"\s*\n\s*(?:# )?", " ", text_of(name))
        for page, anchor, *sections in citation.findall(text):
            assert os.path.isfile(os.path.join(ROOT, page)), "%s cites %s, which is not here" % (name, page)
            titles, anchors = headings(page)
            assert not anchor or anchor in anchors, "%s cites %s#%s: no such heading" % (name, page, anchor)
            for number in filter(None, sections):
                there = any(title.startswith((number + " ", number + ". ")) for title in titles)
                assert there, "%s cites %s, section %s: no such section" % (name, page, number)
        if name.endswith(".py"):
            for line in re.findall(r"(?:#|\"\"\").*", text_of(name)):
                for page in re.findall(r"\b[a-z]\w*\.md\b", line):
                    assert page in known, "%s cites %s, which is not here" % (name, page)


@pytest.mark.parametrize("name", tracked(".md"))
def test_lines_of_the_documents_are_120_columns(name):
    for number, line in enumerate(text_of(name).splitlines(), 1):
        assert len(line) <= 120 or line.startswith("|"), "%s:%d has %d columns" % (name, number, len(line))


def test_every_folder_and_file_of_the_guide_is_there():
    """docs/finding_your_way.md lists each folder of the repository once, and the files that it names exist."""
    guide = text_of("docs/finding_your_way.md")
    listed = re.findall(r"^[│ ]*[├└]── (\S+) ", guide, re.MULTILINE)
    folders = {os.path.dirname(name) for name in tracked() if os.path.dirname(name)}
    folders |= {os.path.dirname(folder) for folder in folders} - {""}
    folders = {folder for folder in folders if not folder.startswith(".")}
    assert sorted(listed) == sorted(os.path.basename(folder) for folder in folders)
    questions = re.findall(r"^\| (.+\?) \| (.+) \| (.*) \|$", guide[: guide.index("## The folders")], re.MULTILINE)
    assert len(questions) == 15
    for question, files_to_open, there in questions:
        paths = re.findall(r"`([\w./]+)`", files_to_open)
        places = [path if os.path.exists(os.path.join(ROOT, path)) else "applr_ros1/" + path for path in paths]
        assert 1 <= len(places) <= 2, question
        assert all(os.path.exists(os.path.join(ROOT, place)) for place in places), "the guide names %s" % places
        texts = " ".join(text_of(place) for place in places if os.path.isfile(os.path.join(ROOT, place)))
        for name in re.findall(r"`(?:\w+\.)?(\w+)`", there):
            assert re.search(r"\b%s\b" % name, texts), "%s: %s is not in %s" % (question, name, places)


def help_texts(name):
    """(line, text) of each option that a file declares, for argparse or as a field of the training options."""
    for node in ast.walk(ast.parse(text_of(name))):
        called = getattr(getattr(node, "func", None), "attr", getattr(getattr(node, "func", None), "id", ""))
        if called == "add_argument":
            text = next((keyword.value for keyword in node.keywords if keyword.arg == "help"), None)
        elif called == "option" and len(node.args) > 1:
            text = node.args[1]
        else:
            continue
        text = text.left if isinstance(text, ast.BinOp) and isinstance(text.op, ast.Mod) else text
        if text is None or isinstance(text, ast.Constant):
            yield node.lineno, text and text.value


@pytest.mark.parametrize("name", python_files(PACKAGES))
def test_help_texts_are_whole_sentences(name):
    for line, text in help_texts(name):
        whole = bool(text) and text[0].isupper() and text.endswith(".")
        assert whole, "%s:%d: help text %r" % (name, line, text)


@pytest.mark.parametrize("name", python_files(PACKAGES) + tracked(".md"))
def test_modules_named_in_the_text_are_there(name):
    """A module that a comment, docstring or page names, with or without its folder, exists."""
    there = ["/" + other for other in tracked(".py")]
    for named in set(re.findall(r"(?<![\w./])[\w/]+\.py\b", text_of(name))):
        known = any(other.endswith("/" + named) for other in there) or os.path.basename(named).startswith("my_")
        assert known, "%s names %s, which is not here" % (name, named)


@pytest.mark.parametrize("name", tracked(".md"))
def test_links_of_the_documents_hold(name):
    """Each relative link leads to a file of the repository, and to a heading that is there."""
    for target, anchor in re.findall(r"\]\(([^)#:\s]*)(?:#([^)\s]+))?\)", text_of(name)):
        path = os.path.normpath(os.path.join(os.path.dirname(name), target)) if target else name
        assert os.path.exists(os.path.join(ROOT, path)), "%s links to %s" % (name, target)
        assert not anchor or anchor in headings(path)[1], "%s links to %s#%s" % (name, target, anchor)


@pytest.mark.parametrize(
    "command",
    [
        ("ruff", "check", "--output-format", "concise", "--no-cache"),
        ("ruff", "format", "--check", "--no-cache"),
        ("mypy",),
    ],
    ids=["ruff check", "ruff format", "mypy"],
)
def test_linters_and_types(command):
    tool = [sys.executable, "-m", *command]
    if subprocess.run(tool[:3] + ["--version"], capture_output=True, check=False).returncode:
        pytest.skip("%s is not installed for this Python" % command[0])
    found = subprocess.run(tool, cwd=ROOT, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stdout + found.stderr


def test_citation_workflow_and_hooks_are_well_formed():
    """CITATION.cff names the version and the paper, the workflow runs .ci/run, and hooks run the venv's tools."""
    citation = yaml.safe_load(text_of("CITATION.cff"))
    assert {"cff-version", "message", "title", "authors"} <= set(citation)
    assert citation["version"] == xml.parse(os.path.join(ROOT, "package.xml")).getroot().findtext("version")
    assert len(citation["references"][0]["authors"]) == 8
    (job,) = yaml.safe_load(text_of(".github/workflows/ci.yml"))["jobs"].values()
    assert job["container"] == "debian:12"
    assert job["steps"][-1]["run"] == ".ci/run"
    (hooks,) = yaml.safe_load(text_of(".pre-commit-config.yaml"))["repos"]
    for hook in hooks["hooks"]:
        assert hook["language"] == "system"
        assert hook["entry"].startswith(".applr/venv/bin/python -m ")
