"""Configuration of all tests: selection, distribution to processes, measurements of faults.

A test that takes more than a quarter of an hour fails, but tests marked `long` may take hours.
Failed tests are not repeated: a test that fails only on a busy machine is defective.

`./applr test` runs pytest-xdist. Because rospy supports one master per process, tests of one file
that start ROS nodes run in one process (`--dist loadgroup`), as do all files of a folder whose
conftest.py has a shared stack. Between two such groups, tests.support.ros starts a new master and
unregisters the topics of this process. Between two tests, it deletes the parameters of nodes that
have ended.

Tests marked `slow` run only with `--all` or if `-m` names them, tests marked `long` only if `-m`
names them. Without `--all`, random comparisons run a part of their cases (tests/support/seeds.py).
With `--quick`, tests marked `heavy` are left out, and those that need ROS or start a process are
skipped (tests/support/quick.py). A file that imports a package that is not installed (ROS, or torch
under Python 3.8) is skipped. A run in which no test passed is a failure.
`--faults-table=docs/results/faults.csv` writes the measurements of the fault tests into that table.
"""

import collections
import contextlib
import csv
import importlib.util
import os
import re
import signal
import sys
from pathlib import Path

import pytest

from tests.support import quick, seeds

# A cancelled job or closed terminal must act like Ctrl-C, so that processes started by tests end as
# well.
for signal_number in (signal.SIGTERM, signal.SIGHUP):
    if signal.getsignal(signal_number) == signal.SIG_DFL:
        signal.signal(signal_number, signal.default_int_handler)
# A shell ignores SIGINT in background jobs. Children would inherit this, and Ctrl-C end none.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# On a busy machine, threads of torch or BLAS wait for each other, and take 20 times as long as a
# single thread.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.pop("ROS_NAMESPACE", None)  # Tests name topics from the root.
pytest.register_assert_rewrite("tests.support.nodes")
if importlib.util.find_spec("torch") is None:  # Without torch, training and its tests are skipped.
    sys.modules["training"] = None
MADE_BY_CATKIN = {"applr_ros1.msg", "applr_ros1.srv", "applr_ros1.cfg"}
OWN_PACKAGES = {"applr_ros1", "sim_bridge", "worlds", "training", "tests"}


def group_of(path):
    """Return the file, or its folder if this has a conftest.py with shared fixtures."""
    folder = path.parent
    # This file's own folder has fixtures of no stack.
    if folder != Path(__file__).parent and (folder / "conftest.py").exists():
        return folder
    return path


def pytest_addoption(parser):
    parser.addoption(
        "--all",
        action="store_true",
        help="Also run tests marked slow, and all cases of comparisons.",
    )
    parser.addoption(
        "--quick",
        action="store_true",
        help="Only light tests that need neither ROS nor another process.",
    )
    parser.addoption(
        "--faults-table",
        metavar="CSV",
        help="Table (docs/results/faults.csv) for measurements of faults.",
    )


def pytest_configure(config):
    seeds.share = 1.0 if config.option.all else seeds.FIRST_SHARE
    if config.option.quick:
        quick.hide_packages()


@pytest.fixture(scope="session", autouse=True)
def no_processes(pytestconfig):
    """With --quick, skip each test that starts a process."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        if pytestconfig.option.quick:
            quick.forbid_processes(monkeypatch)
        yield


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector):
    """Skip a file that imports a package that is not installed."""
    report = yield
    import_error = re.search(
        r"ModuleNotFoundError: (?:No module named '|import of )([\w.]+)", str(report.longrepr)
    )
    if report.failed and import_error:
        module = import_error.group(1)
        package, _, _ = module.partition(".")
        # `training` is None without torch, see above.
        is_switched_off = sys.modules.get(package, 0) is None
        if package not in OWN_PACKAGES or module in MADE_BY_CATKIN or is_switched_off:
            report.outcome = "skipped"
            report.longrepr = (str(collector.path), 1, "Skipped: no %s here" % package)
    return report


def pytest_itemcollected(item):
    for mark in item.iter_markers("fault"):
        for fault_number in mark.args:
            item.user_properties.append(("fault", fault_number))
    if item.get_closest_marker("long"):
        item.add_marker(pytest.mark.timeout(0))
    if item.get_closest_marker("ros"):
        item.add_marker(pytest.mark.xdist_group(group_of(item.path).stem))


def pytest_collection_modifyitems(config, items):
    named_marks = config.option.markexpr + " slow" * config.option.all
    left_out_marks = ["slow", "long"]
    if config.option.quick:
        left_out_marks += ["ros", "heavy"]
    chosen_items = items
    for mark in left_out_marks:
        if mark not in named_marks:
            chosen_items = [item for item in chosen_items if not item.get_closest_marker(mark)]
    # pytest takes its own list, changed in place.
    items[:] = chosen_items


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    report = yield
    if report.failed and item.config.option.quick:
        package = quick.missing_simulator(call.excinfo.value)
        if package:
            report.outcome = "skipped"
            report.longrepr = (str(item.path), 1, "Skipped: no %s here" % package)
    item.has_failed = report.failed or getattr(item, "has_failed", False)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item, nextitem):
    """End a test's nodes. After a failed test marked `ros`, also end its fixtures and the
    master.
    """
    try:
        return (yield)
    finally:
        # Imported here, it would need ROS for tests without ROS.
        harness = sys.modules.get("tests.support.ros")
        failed = item.has_failed
        if harness:
            harness.forget_ended()
            if failed and item.get_closest_marker("ros"):
                # The test's failure is reported already, and may make its fixtures fail, too.
                with contextlib.suppress(Exception, pytest.fail.Exception):
                    item.session._setupstate.teardown_exact(None)
            if failed or nextitem is None or group_of(nextitem.path) != group_of(item.path):
                harness.close_session()


@pytest.fixture
def measured(request):
    """Provide measured(what, value, unit), which records a measurement of this test for the table
    of faults.
    """

    def keep(what, value, unit):
        request.node.user_properties.append(("figure", (what, float(value), unit)))

    return keep


def write_figures(path, reports):
    """Write measurements into the column `measured` of the table of faults, for each fault that
    tests provoked.
    """
    largest = {}  # number of the fault: {(what, unit): value}
    for report in reports:
        properties = collections.defaultdict(list)
        for property_name, content in report.user_properties:
            properties[property_name].append(content)
        for fault_number in properties["fault"]:
            measurements = largest.setdefault(fault_number, {})
            for what, value, unit in properties["figure"]:
                # A table of faults promises what holds in the worst case.
                measurements[what, unit] = max(value, measurements.get((what, unit), value))

    with open(path, encoding="utf-8", newline="") as table_file:
        fault_rows = list(csv.DictReader(table_file))
    for fault_row in fault_rows:
        # Faults of tests that were left out in this run keep their figures.
        if fault_row["number"] not in largest:
            continue
        phrases = []
        for (what, unit), value in largest[fault_row["number"]].items():
            # Counts have no unit.
            phrases.append(("%s: %.3g %s" % (what, value, unit)).rstrip())
        fault_row["measured"] = "; ".join(phrases) or "passes"

    with open(path, "w", encoding="utf-8", newline="") as table_file:
        writer = csv.DictWriter(table_file, list(fault_rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(fault_rows)


def pytest_sessionfinish(session, exitstatus):
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if reporter is None:  # This process is a worker of pytest-xdist.
        return
    passed_reports = reporter.stats.get("passed", [])
    if session.config.option.faults_table:
        write_figures(session.config.option.faults_table, passed_reports)
    # Else a run that skipped all files, because a package is missing, would be green.
    if exitstatus == 0 and not session.config.option.collectonly and not passed_reports:
        session.exitstatus = pytest.ExitCode.NO_TESTS_COLLECTED
