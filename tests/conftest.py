"""For all tests: a run in which no test passed is a failure; what needs Python 3.10 is left out on Noetic's 3.8."""
import re
import sys
from pathlib import Path

if sys.version_info < (3, 10):
    needs_training = re.compile(r"^\s*(from|import) (training|torch|gymnasium|ray)\b", re.MULTILINE)
    collect_ignore = [path.name for path in Path(__file__).parent.glob("test_*.py")
                      if needs_training.search(path.read_text(encoding="utf-8"))]


def pytest_sessionfinish(session, exitstatus):
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if exitstatus == 0 and reporter is not None and not session.config.option.collectonly:
        if not reporter.stats.get("passed"):
            session.exitstatus = 5
