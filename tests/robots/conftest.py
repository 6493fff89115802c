"""Descriptions are checked here; tests/training/test_open_floor.py drives on open floor. Each text is parsed once."""

import copy

import pytest

from applr_ros1.robots import parameter_files
from training import check_robot

PARSED = {}  # {(text, loader): value}, for all tests: folders of robots are copied with a change in one of their files


@pytest.fixture(autouse=True)
def undriven(monkeypatch):
    """A check that ends where the drive on open floor begins."""
    monkeypatch.setattr(check_robot.open_floor, "check", lambda robot: (True, []))


@pytest.fixture(autouse=True)
def parsed_once(monkeypatch):
    """A parser of YAML that remembers values."""
    parse = parameter_files.yaml_value

    def remembered(text, name, loader):
        if (text, loader) not in PARSED:
            PARSED[text, loader] = parse(text, name, loader)
        return copy.deepcopy(PARSED[text, loader])

    monkeypatch.setattr(parameter_files, "yaml_value", remembered)
