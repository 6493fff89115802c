"""Tests of --verbose, which every desk command has: what is loaded, tried and left out."""

import logging
import re
import shutil

import pytest

from applr_ros1.common.extras import OURS
from applr_ros1.robots import JACKAL, load
from training.common.command_line import given
from training.common.options import Options


@pytest.fixture
def loggers():
    """Give this repository's loggers back as they were."""
    loggers = [logging.getLogger(package) for package in OURS]
    handlers = [list(logger.handlers) for logger in loggers]
    yield
    for logger, own_handlers in zip(loggers, handlers):
        logger.handlers[:] = own_handlers
        logger.setLevel(logging.NOTSET)


@pytest.mark.parametrize("words", [[], ["--verbose"]])
def test_verbose_reports_with_times_what_is_loaded(words, loggers, tmp_path, capsys):
    assert given(Options, "program", None, words) == {}

    folder = shutil.copytree(JACKAL.folder, tmp_path / "own")
    load(str(folder))

    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == len(words)
    for line in lines:
        assert re.match(r" *\d+ ms  applr_ros1\.robots\.folder: robot %s: \d+ " % folder, line)
