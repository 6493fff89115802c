"""Measured values are written into a robot.yaml of any legal form, and nothing else changes."""

import json
from pathlib import Path

import pytest
import yaml

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import StorageError
from applr_ros1.robots import JACKAL, NAMES, load
from applr_ros1.robots.measured import Value
from applr_ros1.robots.owner.write import write_measured
from applr_ros1.robots.parameter_files import read_yaml
from applr_ros1.robots.robot import FILE, RobotFile

TEXT = (Path(JACKAL.folder) / FILE).read_text()
VALUES = yaml.safe_load(TEXT)
NUMBERS = {
    ("monitor", "deceleration"): 1.234,
    ("monitor", "turn_gain"): 1e-05,  # "1e-05" would be a text
    ("simulation", "command_delay"): 0.08,
    ("laser", "no_return"): 0.0,
    ("odometry", "lag"): 0.03,
    ("base", "max_speed"): 1.5,
}
MEASURED = {place: Value(number, "", 0.05, "40 moments") for place, number in NUMBERS.items()}


def without(section, more):
    return yaml.safe_dump({name: value for name, value in VALUES.items() if name != section}) + more


IN_PLACE = {
    **{name: (Path(load(name).folder) / FILE).read_text() for name in NAMES},
    "block": yaml.safe_dump(VALUES),
    "flow": yaml.safe_dump(VALUES, default_flow_style=True),
    "json": json.dumps(VALUES),
    "json over lines": json.dumps(VALUES, indent=1),
    "all indented": "".join("  " + line if line.strip() else line for line in TEXT.splitlines(True)),
    "document start": "---\n" + TEXT,
    "document end": TEXT.rstrip("\n") + "\n...\n",
    "carriage returns": TEXT.replace("\n", "\r\n"),
    "no last newline": TEXT.rstrip("\n"),
    "byte order mark": "\ufeff" + TEXT,
    "quoted sections": TEXT.replace("\nmonitor:", '\n"monitor":').replace("\nsimulation:", "\n'simulation':"),
    "space before a section's colon": TEXT.replace("\nmonitor:", "\nmonitor :"),
    "tag": TEXT.replace("\nmonitor:", "\nmonitor: !!map"),
    "anchor of a section": TEXT.replace("\nmonitor:", "\nmonitor: &m"),
    "anchor of a section in flow": without("monitor", "monitor: &mm {deceleration: 1.9, margin: 0.03}\n"),
    "section in flow over lines": without("monitor", "monitor: {\n  margin: 0.03,\n  deceleration: 1.9\n}\n"),
    "comment with another value": without("monitor", "monitor:\n  # deceleration: 4.0 here\n  deceleration: 1.9\n"),
    "comment with a brace": without("monitor", "monitor:  # as {measured}\n  margin: 0.03\n"),
    "comment at the line's start": without("monitor", "monitor:\n  margin: 0.03\n# brakes\n  deceleration: 1.9\n"),
    "section is not there": without("odometry", ""),
    "section is empty": without("odometry", "odometry:\nworld_scale: 1.0\n"),
    "section is null": without("odometry", "odometry: ~\n"),
    "section is nothing in flow": without("odometry", "odometry: {}\n"),
    "four spaces": without("monitor", "monitor:\n    margin: 0.03\n    reaction_time: 0.2\n"),
    "quoted key": without("monitor", 'monitor:\n  "deceleration": 1.9\n  margin: 0.03\n'),
    "space before a key's colon": without("monitor", "monitor:\n  deceleration : 1.9\n  margin: 0.03\n"),
    "value on the next line": without("monitor", "monitor:\n  deceleration:\n    1.9\n  margin: 0.03\n"),
    "value is empty": without("monitor", "monitor:\n  deceleration:\n  margin: 0.03\n"),
    "value is twice there": without("monitor", "monitor:\n  deceleration: 1.9\n  deceleration: 2.0\n"),
    "anchor of a value": without("monitor", "monitor:\n  deceleration: &a 1.9\n  margin: 0.03\n"),
    "merged section": without("monitor", "monitor:\n  <<: {margin: 0.03}\n  reaction_time: 0.2\n"),
    "question mark": without("monitor", "? monitor\n: {margin: 0.03}\n"),
    "umlaut": "# für\n" + TEXT,
    "another encoding": ("# für\n" + TEXT).encode("latin-1"),
    "angles of rosparam": TEXT.replace("first_angle: -2.35619", "first_angle: deg(-135)"),
}
ANEW = {
    "value is an alias": without("monitor", "monitor:\n  margin: &a 0.5\n  deceleration: *a\n"),
    "value has an alias": without("monitor", "monitor:\n  deceleration: &a 0.5\n  margin: *a\n"),
    "section is an alias": "defaults: &d {margin: 0.03}\n" + without("monitor", "monitor: *d\n"),
    "question mark in a section": without("monitor", "monitor:\n  ? margin\n  : 0.03\n"),
}
NOT_SECTIONS = {
    "list": ("- 1\n", "holds no mapping"),
    "section is a list": (without("monitor", "monitor: [1]\n"), "not sections of values; nothing was written"),
    "utf-16": (TEXT.encode("utf-16"), "not readable as YAML"),
}


def in_folder(folder, text):
    file = folder / FILE
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return file


@pytest.mark.parametrize("form", [*IN_PLACE, *ANEW])
def test_values_change_in_every_form_of_yaml_and_nothing_else(tmp_path, form):
    file = in_folder(tmp_path, {**IN_PLACE, **ANEW}[form])
    old = file.read_bytes()
    expected = read_yaml(file)
    for (section, name), number in NUMBERS.items():
        expected[section] = {**(expected.get(section) or {}), name: number}
    lines = write_measured(tmp_path, MEASURED)
    new = file.read_bytes()
    assert read_yaml(file) == expected
    for section, name in NUMBERS:
        assert new.decode("latin-1").count(f"# measured: {section}.{name} ") == 1
    copies = [path for path in tmp_path.iterdir() if path != file]
    if form in ANEW:
        assert [path.read_bytes() for path in copies] == [old]
        said = f"{file}: written anew for measured values, without comments and layout; as it was: {copies[0]}"
        assert lines == [said]
    else:
        assert (lines, copies) == ([], [])
        assert [line for line in old.splitlines() if line.startswith(b"#") and line not in new] == []
    assert write_measured(tmp_path, MEASURED) == []
    assert file.read_bytes() == new


@pytest.mark.parametrize("form", NOT_SECTIONS)
def test_a_file_without_sections_is_one_line_and_untouched(tmp_path, form):
    file = in_folder(tmp_path, NOT_SECTIONS[form][0])
    before = file.read_bytes()
    with pytest.raises(ApplrError, match=f"robot.yaml: {NOT_SECTIONS[form][1]}"):
        write_measured(tmp_path, MEASURED)
    assert file.read_bytes() == before
    assert list(tmp_path.iterdir()) == [file]


def test_a_text_that_holds_other_values_than_it_should_is_not_written(tmp_path, monkeypatch):
    file = in_folder(tmp_path, TEXT)
    monkeypatch.setattr("applr_ros1.robots.owner.write._with_number", lambda text, *_: text.replace("0.5", "0.4"))
    with pytest.raises(StorageError, match="cannot be written as YAML again; nothing was written"):
        write_measured(tmp_path, MEASURED)
    assert file.read_text() == TEXT
    assert list(tmp_path.iterdir()) == [file]


def test_measured_values_are_the_robots_and_stand_below_how_they_were_measured(tmp_path):
    file = in_folder(tmp_path, TEXT)
    write_measured(
        tmp_path,
        {
            ("monitor", "turn_gain"): Value(1.234, "", 0.05, "40 moments"),
            ("laser", "noise"): Value(0.02, "m", 0.001, "50 scans standing"),
        },
    )
    assert "# measured: monitor.turn_gain 1.23 +- 0.05 (40 moments)\nmonitor: {" in file.read_text()
    assert "# measured: laser.noise 0.02 m +- 0.001 (50 scans standing)\nlaser:\n" in file.read_text()
    read = RobotFile.model_validate(yaml.safe_load(file.read_text()))
    assert read.monitor == JACKAL.monitor.model_copy(update={"turn_gain": 1.234})
    assert read.laser == JACKAL.laser.model_copy(update={"noise": 0.02})
    assert (read.base, read.simulation, read.odometry) == (JACKAL.base, JACKAL.simulation, JACKAL.odometry)
