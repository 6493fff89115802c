"""Tests of the whole repository: linters, types, import contracts (pyproject.toml), declared
dependencies, and references between files."""

import ast
import csv
import re
import subprocess
import sys
import xml.etree.ElementTree as xml
from pathlib import Path

import pytest

from tests.support import HANGS, ROOT

LINTERS = {
    "ruff check": ("ruff", "check", "--output-format", "concise", "--no-cache"),
    "ruff format": ("ruff", "format", "--check", "--no-cache"),
    "mypy": ("mypy",),
    "import contracts": ("lint-imports", "--no-cache"),
}
# Modules of ROS that are imported here, besides *_msgs and *_srvs
ROS = {"rospy", "rosgraph", "roslib", "rosbag", "actionlib", "dynamic_reconfigure", "tf2_ros"}
# Libraries whose import takes so long that a command without need for them must not wait for it
HEAVY = (
    "torch tensorboard pandas matplotlib PIL scipy.stats scipy.signal cma ruptures ray pybullet "
    "trimesh viser"
)
# Program that starts every command with --help, and prints who imports a heavy library first
STARTS = """
import contextlib, io, sys
from applr_ros1.common.errors import run_script
from applr_ros1.scripts.__main__ import COMMANDS, NODES

seen = set()

def report(who):
    heavy = HEAVY & set(sys.modules) - seen
    seen.update(heavy)
    print(*[f"{who} imports {name}" for name in sorted(heavy)], sep=chr(10), end="")

import training.evaluate.runner, training.workers.collect
report("a worker")
for name, module in {**COMMANDS, **NODES}.items():
    sys.argv = [name, "--help"]
    ours = module.startswith("training.")
    ends = [SystemExit] if ours else [SystemExit, ModuleNotFoundError]  # Other commands need ROS.
    with contextlib.redirect_stdout(io.StringIO()) as output, contextlib.suppress(*ends):
        run_script(module, name in NODES)
    assert not ours or "usage" in output.getvalue(), output.getvalue()
    report(name)
"""
NOT_OURS = {"tests", ".applr", ".git", ".pytest_cache"}


def files(*patterns):
    """Return the repository's files, without tests, whose names match one of the patterns."""
    paths = []
    for pattern in patterns:
        for path in sorted(ROOT.rglob(pattern)):
            if path.relative_to(ROOT).parts[0] not in NOT_OURS:
                paths.append(path)
    return paths


@pytest.mark.parametrize(
    "name",
    ["ruff check", "ruff format", pytest.param("mypy", marks=pytest.mark.slow), "import contracts"],
)
def test_linters(name):
    program, *options = LINTERS[name]
    program = Path(sys.executable).with_name(program)
    if not program.exists():
        pytest.skip("%s is not installed for this Python" % program.name)
    finished = subprocess.run(
        [program, *options], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert finished.returncode == 0, finished.stdout + finished.stderr


def test_help_invalid_options_and_workers_import_no_heavy_library():
    code = f"HEAVY = set({HEAVY.split()})\n{STARTS}"
    finished = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=HANGS
    )
    assert (finished.returncode, finished.stdout) == (0, ""), finished.stdout + finished.stderr


def test_package_xml_declares_the_ros_packages_that_are_imported():
    package = xml.parse(ROOT / "package.xml").getroot()
    declared = {node.text for node in package if node.tag.endswith("depend")}
    imported = set()
    for folder in ("applr_ros1", "sim_bridge", "worlds"):
        for path in (ROOT / folder).rglob("*.py"):
            imported |= imports_of(path)
    # From python3-rospkg, from std_msgs, in compat/
    elsewhere = {"rospkg", "genpy", "gazebo_msgs"}
    packages = set()
    for name in imported - elsewhere:
        if name in ROS or name.endswith(("_msgs", "_srvs")):
            packages.add(name)
    assert packages <= declared, "package.xml lacks %s" % sorted(packages - declared)


def imports_of(path):
    """Return the top-level packages that a Python file imports anywhere."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names.add(node.module.partition(".")[0])
    return names


def test_every_launch_argument_is_documented():
    for path in files("*.launch"):
        for argument in xml.parse(path).getroot().findall("arg"):
            # An argument with a value is a constant of the file, not for users.
            is_constant = argument.get("value") is not None
            assert is_constant or argument.get("doc"), f"{path}: {argument.get('name')}"


def headings(page):
    """Return the headings of a Markdown file, and their anchors."""
    titles = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return titles, {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}


def test_cited_pages_and_sections_exist():
    section = r"\d+(?:\.\d+)*"
    citation = re.compile(
        r"\b(docs/[\w./]+\.md)(?:#([\w-]+)|,? sections? (%s)(?: to (%s))?)?" % (section, section)
    )
    count = 0
    for path in files("*.py", "*.cfg", "*.md", "*.launch", "*.yaml", "applr"):
        if not path.is_file():
            continue
        # A citation may go on in the next line, in a comment after "# ".
        text = re.sub(r"\s*\n\s*(?:# )?", " ", path.read_text(encoding="utf-8"))
        for page, anchor, *sections in citation.findall(text):
            assert (ROOT / page).is_file(), "%s cites %s" % (path, page)
            titles, anchors = headings(ROOT / page)
            assert not anchor or anchor in anchors, "%s cites %s#%s" % (path, page, anchor)
            for number in filter(None, sections):
                is_there = any(title.startswith((number + " ", number + ". ")) for title in titles)
                assert is_there, "%s cites %s, section %s" % (path, page, number)
            count += 1
    assert count > 20, "the pattern finds no citations any more"


def test_links_between_pages_have_targets():
    link = re.compile(r"\]\(([^)#:\s]*)(?:#([^)\s]+))?\)")
    for path in files("*.md"):
        # sphinx checks the links of the site, see test_docs.py.
        if path.relative_to(ROOT).parts[0] == "docs":
            continue
        for target, anchor in link.findall(path.read_text(encoding="utf-8")):
            page = path.parent / target if target else path
            assert page.exists(), f"{path} links to {target}"
            assert not anchor or anchor in headings(page)[1], f"{path} links to {target}#{anchor}"


def test_every_fault_of_the_table_has_a_test():
    with open(ROOT / "docs/results/faults.csv", encoding="utf-8", newline="") as file:
        numbers = {row["number"] for row in csv.DictReader(file)}
    tested = set()
    for path in (ROOT / "tests").rglob("test_*.py"):
        for marked in re.findall(r"pytest\.mark\.fault\((.+?)\)", path.read_text(encoding="utf-8")):
            tested.update(re.findall(r'"(\w+)"', marked))
    assert numbers == tested


def test_docstrings_and_comments_begin_with_a_noun_or_a_verb():
    clause = re.compile(r'"""(What|Whether|Who|Those|That|So many)\b|# (of|that|which|where) ')
    for path in files("*.py"):
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            assert not clause.search(line), f"{path}:{number}: {line.strip()}"
