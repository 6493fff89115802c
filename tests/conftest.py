"""For all tests: a run in which no test passed is a failure; what needs Python 3.10 is left out on Noetic's 3.8."""
import sys

if sys.version_info < (3, 10):
    collect_ignore_glob = ["test_training*", "test_td3*", "test_env*", "test_episode*", "test_dataset*"]


def pytest_sessionfinish(session, exitstatus):
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if exitstatus == 0 and reporter is not None and not session.config.option.collectonly:
        if not reporter.stats.get("passed"):
            session.exitstatus = 5
