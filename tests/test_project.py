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
# And *_msgs, *_srvs.
ROS = {
    "rospy",
    "rosgraph",
    "roslib",
    "rosbag",
    "actionlib",
    "dynamic_reconfigure",
    "tf2_ros",
}
HEAVY = (
    "torch tensorboard pandas matplotlib PIL scipy.stats scipy.signal cma ruptures ray pybullet "
    "trimesh viser"
)
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


def files(pattern):
    return [
        path
        for path in sorted(ROOT.rglob(pattern))
        if path.relative_to(ROOT).parts[0] not in NOT_OURS
    ]


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name == "mypy")) for name in LINTERS]
)
def test_linters(name):
    program, *options = LINTERS[name]
    program = Path(sys.executable).with_name(program)
    if not program.exists():
        pytest.skip("%s is not installed for this Python" % program.name)
    done = subprocess.run(
        [program, *options], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_help_invalid_options_and_workers_import_no_heavy_library():
    code = f"HEAVY = set({HEAVY.split()})\n{STARTS}"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=HANGS
    )
    assert (done.returncode, done.stdout) == (0, ""), done.stdout + done.stderr


def test_package_xml_declares_the_ros_packages_that_are_imported():
    package = xml.parse(ROOT / "package.xml").getroot()
    declared = {node.text for node in package if node.tag.endswith("depend")}
    used = set()
    for path in [
        path
        for folder in ("applr_ros1", "sim_bridge", "worlds")
        for path in (ROOT / folder).rglob("*.py")
    ]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                used |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                used.add(node.module.partition(".")[0])
    # From python3-rospkg, from std_msgs, in compat/.
    elsewhere = {"rospkg", "genpy", "gazebo_msgs"}
    ros = {name for name in used - elsewhere if name in ROS or name.endswith(("_msgs", "_srvs"))}
    assert ros <= declared, "package.xml lacks %s" % sorted(ros - declared)


def test_every_launch_argument_is_documented():
    for path in files("*.launch"):
        for argument in xml.parse(path).getroot().findall("arg"):
            assert argument.get("value") is not None or argument.get("doc"), "%s: %s" % (
                path,
                argument.get("name"),
            )


def headings(page):
    """Return the headings of a Markdown file, and their anchors."""
    titles = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return titles, {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}


def test_cited_pages_and_sections_exist():
    section = r"\d+(?:\.\d+)*"
    citation = re.compile(
        r"\b(docs/[\w./]+\.md)(?:#([\w-]+)|,? sections? (%s)(?: to (%s))?)?" % (section, section)
    )
    cited = 0
    for path in [
        path
        for kind in ("*.py", "*.cfg", "*.md", "*.launch", "*.yaml", "applr")
        for path in files(kind)
    ]:
        text = (
            re.sub(r"\s*\n\s*(?:# )?", " ", path.read_text(encoding="utf-8"))
            if path.is_file()
            else ""
        )
        for page, anchor, *sections in citation.findall(text):
            assert (ROOT / page).is_file(), "%s cites %s" % (path, page)
            titles, anchors = headings(ROOT / page)
            assert not anchor or anchor in anchors, "%s cites %s#%s" % (path, page, anchor)
            for number in filter(None, sections):
                there = any(title.startswith((number + " ", number + ". ")) for title in titles)
                assert there, "%s cites %s, section %s" % (path, page, number)
            cited += 1
    assert cited > 20


def test_links_between_pages_have_targets():
    for path in [
        path for path in files("*.md") if path.relative_to(ROOT).parts[0] != "docs"
    ]:  # see test_docs.py
        for target, anchor in re.findall(
            r"\]\(([^)#:\s]*)(?:#([^)\s]+))?\)", path.read_text(encoding="utf-8")
        ):
            page = path.parent / target if target else path
            assert page.exists(), "%s links to %s" % (path, target)
            assert not anchor or anchor in headings(page)[1], "%s links to %s#%s" % (
                path,
                target,
                anchor,
            )


def test_every_fault_of_the_table_has_a_test():
    with open(ROOT / "docs/results/faults.csv", encoding="utf-8", newline="") as file:
        numbers = {row["number"] for row in csv.DictReader(file)}
    tests = "".join(
        path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py")
    )
    marked = " ".join(re.findall(r"pytest\.mark\.fault\((.+?)\)", tests))
    assert numbers == set(re.findall(r'"(\w+)"', marked))


def test_docstrings_and_comments_begin_with_a_noun_or_a_verb():
    odd = re.compile(r'"""(What|Whether|Who|Those|That|So many)\b|# (of|that|which|where) ')
    for path in [path for path in files("*.py") if path.relative_to(ROOT).parts[0] != "tests"]:
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            assert not odd.search(line), "%s:%d: %s" % (path, number, line.strip())
