"""Test of the Python version that training needs."""

import importlib
import sys
from collections import namedtuple

import pytest

import training
from applr_ros1.common.errors import ApplrError

Version = namedtuple("Version", "major minor")


def test_an_old_python_is_refused_in_one_line(monkeypatch):
    monkeypatch.setattr(sys, "version_info", Version(3, 8))
    with pytest.raises(ApplrError, match="needs Python 3.10 or later, this is 3.8: use a desk"):
        importlib.reload(training)
    monkeypatch.undo()
    importlib.reload(training)
