"""Tests of the whole repository: linters, types, import contracts (pyproject.toml), declared
dependencies, and references between files."""

import ast
import csv
import re
import subprocess
import sys
import xml.etree.ElementTree as xml
from collections import defaultdict
from pathlib import Path

import pytest

from tests.support import HANGS, ROOT

LINTERS = {
    "ruff check": ("ruff", "check", "--output-format", "concise", "--no-cache"),
    "ruff format": ("ruff", "format", "--check", "--no-cache"),
    "mypy": ("mypy",),
    "import contracts": ("lint-imports", "--no-cache"),
}
# Modules of ROS that this repository imports, besides *_msgs and *_srvs
ROS_MODULES = {
    "rospy",
    "rosgraph",
    "roslib",
    "rosbag",
    "actionlib",
    "dynamic_reconfigure",
    "tf2_ros",
}
# Libraries whose import takes so long that a command without need for them must not wait for it
HEAVY = (
    "numba scipy.linalg scipy.spatial scipy.stats scipy.signal torch tensorboard pandas matplotlib "
    "PIL cma ruptures ray pybullet trimesh viser"
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
# Tests of which --quick runs the first
OF_EACH_KIND = """
import subprocess
import sys

import pytest

def test_computes():
    assert "rospy" not in sys.modules or sys.modules["rospy"] is None

@pytest.mark.heavy
def test_computes_long():
    raise AssertionError("left out")

def test_starts_a_process():
    subprocess.run([sys.executable, "--version"], check=True)

def test_needs_a_simulator():
    raise ModuleNotFoundError(name="pybullet")
"""
PRODUCT = ("applr_ros1", "sim_bridge", "training", "worlds")
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
    program = f"HEAVY = set({HEAVY.split()})\n{STARTS}"
    finished = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=HANGS
    )
    assert (finished.returncode, finished.stdout) == (0, ""), finished.stdout + finished.stderr


def test_quick_leaves_out_what_is_heavy_needs_ros_or_starts_a_process(tmp_path):
    (tmp_path / "test_kinds.py").write_text(OF_EACH_KIND)
    (tmp_path / "test_ros.py").write_text("import rospy\n\ndef test_imports(): pass\n")
    options = ("--quick", "-p", "tests.conftest", "-p", "no:cacheprovider", "--rootdir", tmp_path)
    finished = subprocess.run(
        [sys.executable, "-m", "pytest", *options, tmp_path],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=HANGS,
    )
    assert finished.returncode == 0, finished.stdout + finished.stderr
    assert "1 passed, 3 skipped" in finished.stdout


def test_package_xml_declares_the_ros_packages_that_are_imported():
    package = xml.parse(ROOT / "package.xml").getroot()
    declared = {element.text for element in package if element.tag.endswith("depend")}
    imported = set()
    # `training` runs without ROS.
    for folder in ("applr_ros1", "sim_bridge", "worlds"):
        for source_file in (ROOT / folder).rglob("*.py"):
            imported |= imports_of(source_file)
    # From python3-rospkg, from std_msgs, in compat/
    elsewhere = {"rospkg", "genpy", "gazebo_msgs"}
    packages = set()
    for name in imported - elsewhere:
        if name in ROS_MODULES or name.endswith(("_msgs", "_srvs")):
            packages.add(name)
    assert packages <= declared, "package.xml lacks %s" % sorted(packages - declared)


def imports_of(path):
    """Return the top-level packages that a Python file imports anywhere."""
    packages = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                packages.add(alias.name.partition(".")[0])
        # A relative import stays within the package.
        elif isinstance(node, ast.ImportFrom) and not node.level:
            packages.add(node.module.partition(".")[0])
    return packages


def test_the_robots_side_takes_generic_types_from_typing():
    """Python 3.8 cannot subscript those of collections.abc, for instance as a base class."""
    for source_file in files("*.py"):
        if source_file.relative_to(ROOT).parts[0] in ("applr_ros1", "sim_bridge", "worlds"):
            source = source_file.read_text(encoding="utf-8")
            assert "collections.abc" not in source, f"{source_file}: import from typing"


def test_no_two_classes_or_type_aliases_of_the_product_share_a_name():
    places = defaultdict(list)
    for folder in PRODUCT:
        for source_file in sorted((ROOT / folder).rglob("*.py")):
            for node in ast.walk(ast.parse(source_file.read_text(encoding="utf-8"))):
                for name in classes_of(node):
                    places[name.lstrip("_")].append(f"{source_file}:{node.lineno}")
    shared = [(name, *where) for name, where in places.items() if len(where) > 1]
    assert not shared, "name each after its owner: %s" % shared


def classes_of(node):
    """Return the class or the type alias that a syntax node defines. A TypeVar is neither."""
    if isinstance(node, ast.ClassDef):
        return [node.name]
    if isinstance(node, ast.Assign) and not isinstance(node.value, ast.Call):
        target = node.targets[0]
        if isinstance(target, ast.Name):
            return re.findall(r"^_?[A-Z]\w*[a-z]\w*$", target.id)
    return []


def test_every_launch_argument_is_documented():
    for launch_file in files("*.launch"):
        for argument in xml.parse(launch_file).getroot().findall("arg"):
            # An argument with a value is a constant of the file, not for users.
            is_constant = argument.get("value") is not None
            assert is_constant or argument.get("doc"), f"{launch_file}: {argument.get('name')}"


def titles_of(page):
    """Return the headings of a Markdown file."""
    return re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)


def anchors_of(page):
    """Return the anchors of a Markdown file's headings, as GitHub makes them."""
    anchors = set()
    for title in titles_of(page):
        anchors.add(re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-"))
    return anchors


def has_section(page, number):
    """Return whether a Markdown file has a heading with a number, with or without a full stop."""
    beginnings = (number + " ", number + ". ")
    return any(title.startswith(beginnings) for title in titles_of(page))


def test_cited_pages_and_sections_exist():
    section = r"\d+(?:\.\d+)*"
    citation = re.compile(
        r"\b(docs/[\w./]+\.md)(?:#([\w-]+)|,? sections? (%s)(?: to (%s))?)?" % (section, section)
    )
    citation_count = 0
    for citing_file in files("*.py", "*.cfg", "*.md", "*.launch", "*.yaml", "applr"):
        if not citing_file.is_file():
            continue
        # A citation may go on in the next line, in a comment after "# ".
        text = re.sub(r"\s*\n\s*(?:# )?", " ", citing_file.read_text(encoding="utf-8"))
        for page_name, anchor, *sections in citation.findall(text):
            page = ROOT / page_name
            assert page.is_file(), f"{citing_file} cites {page_name}"
            if anchor:
                assert anchor in anchors_of(page), f"{citing_file} cites {page_name}#{anchor}"
            for section_number in filter(None, sections):
                is_there = has_section(page, section_number)
                assert is_there, f"{citing_file} cites {page_name}, section {section_number}"
            citation_count += 1
    assert citation_count > 20, "the pattern finds no citations any more"


def test_links_between_pages_have_targets():
    link = re.compile(r"\]\(([^)#:\s]*)(?:#([^)\s]+))?\)")
    for linking_page in files("*.md"):
        # sphinx checks the links of the site, see test_docs.py.
        if linking_page.relative_to(ROOT).parts[0] == "docs":
            continue
        for target, anchor in link.findall(linking_page.read_text(encoding="utf-8")):
            # A link to an anchor alone leads within the page.
            page = linking_page.parent / target if target else linking_page
            assert page.exists(), f"{linking_page} links to {target}"
            if anchor:
                assert anchor in anchors_of(page), f"{linking_page} links to {target}#{anchor}"


def test_every_fault_of_the_table_has_a_test():
    with open(ROOT / "docs/results/faults.csv", encoding="utf-8", newline="") as table_file:
        fault_numbers = {fault_row["number"] for fault_row in csv.DictReader(table_file)}
    tested_numbers = set()
    # In the text, because files whose packages are not installed cannot be imported.
    for test_file in (ROOT / "tests").rglob("test_*.py"):
        text = test_file.read_text(encoding="utf-8")
        for mark_arguments in re.findall(r"pytest\.mark\.fault\((.+?)\)", text):
            tested_numbers.update(re.findall(r'"(\w+)"', mark_arguments))
    assert fault_numbers == tested_numbers
