"""Tests of the black box without ROS: what it keeps, writes and asks, and when."""

import sys
import time

import pytest

from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.columns import SECOND, TopicNames
from applr_ros1.drives.received import TopicSource
from applr_ros1.robots import JACKAL
from applr_ros1.why.black_box import answer_process
from applr_ros1.why.black_box.answer_process import AnswerProcess
from applr_ros1.why.black_box.bag_file import Publication, RawMessage
from applr_ros1.why.black_box.black_box import BlackBox
from applr_ros1.why.black_box.description import TOPIC, DescribedRobot, described_by
from applr_ros1.why.black_box.ring import Ring
from tests.support.measured_drives import DRIVES, STANDS, drive_of
from tests.why.black_box.test_stops import BEGIN_S, messages_of

ODOMETRY = Publication("/odometry", "nav_msgs/Odometry", "")
SCAN = Publication("/scan", "sensor_msgs/LaserScan", "")


class Folder:
    """Folder that keeps what it is given, and is full on request."""

    def __init__(self):
        self.saved = {}
        self.problem = None

    def save(self, moment, messages):
        if self.problem is not None:
            raise self.problem
        self.saved[moment] = list(messages)
        return f"stop_{moment}.bag"


def stop_in(messages):
    """Return the stop that the first of some messages describes; None without messages."""
    return described_by(messages[0].data[4:].decode(), "stop").stop if messages else None


class Process:
    """Process that keeps what it is asked."""

    def __init__(self):
        self.asked = []
        self.is_running = False
        self.reply = None

    def ask(self, messages):
        was_running = self.is_running
        asked = list(messages)
        self.asked.append((stop_in(asked), asked))
        self.is_running = True
        return was_running

    def answer(self):
        return self.reply

    def end(self):
        self.is_running = False


class Box:
    """A black box, with the messages of drives that come to it."""

    def __init__(self):
        self.folder = Folder()
        self.process = Process()
        self.numbers = iter(range(1000))
        self.box = BlackBox(
            DescribedRobot(JACKAL, TopicNames(), True),
            Ring(120.0, 10**8),
            self.folder,
            self.process,
            lambda: str(next(self.numbers)),
        )
        self.lines = []
        self.problems = []

    def drive(self, twists, begin=0.0, first_look=0.0):
        """Let messages of a drive come, and look twice a second.

        begin: begin of the drive [s]. first_look: time from there to the first look [s].
        """
        due_time = BEGIN_S + begin + first_look
        for message in messages_of(drive_of(twists)):
            arrival = message.recording_time + round(begin * SECOND)
            message = message._replace(recording_time=arrival)
            while due_time <= arrival / SECOND:
                self.look(due_time)
                due_time += 0.5
            raw = RawMessage(arrival, ODOMETRY, str(arrival).encode())
            self.box.take(raw, TopicSource(message.key, {}), lambda message=message: message)

    def take_scan(self, seconds):
        """Let a scan come some time after the begin [s], and return it."""
        scan = RawMessage(round((BEGIN_S + seconds) * SECOND), SCAN, b"scan")
        self.box.take(scan, TopicSource("scans", {}), lambda: None)
        return scan

    def look(self, now):
        """Look at a time by the robot's clock [s]."""
        output = self.box.look(now)
        self.lines += output.lines
        self.problems += output.problems
        return output


def test_a_stop_is_asked_about_at_once_and_written_ten_seconds_later():
    box = Box()
    box.drive(DRIVES * 10 + STANDS * 2)
    ((stop, messages),) = box.process.asked
    assert stop.kind == "stood"
    # Asked when it had lasted five seconds, about the fifteen seconds before it
    assert stop.end == pytest.approx(BEGIN_S + 35.0, abs=0.6)
    description, first_message = messages[:2]
    assert first_message.time / SECOND == pytest.approx(stop.begin - 15.0, abs=0.1)
    # The text follows its length.
    assert described_by(description.data[4:].decode(), "stop").robot.name == "jackal"
    assert box.folder.saved == {}
    assert box.lines == ["the robot stood at (15.00, 0.00)"]

    box.drive(DRIVES * 4, begin=36.0)
    ((moment, saved_messages),) = box.folder.saved.items()
    assert saved_messages[0].publication.topic == TOPIC
    # Everything since the begin, until ten seconds after the stop
    assert saved_messages[1].time == round(BEGIN_S * SECOND)
    assert saved_messages[-1].time / SECOND == pytest.approx(stop.end + 10.0, abs=0.6)
    assert box.lines[-1] == f"wrote stop_{moment}.bag"
    assert box.box.stop_count == 1


def test_the_answer_is_handed_on():
    box = Box()
    box.process.reply = {"sentence": "because"}
    assert box.look(BEGIN_S).answer == {"sentence": "because"}


def test_the_next_stop_drops_the_answer_to_the_one_before():
    box = Box()
    box.drive(DRIVES + STANDS * 2 + DRIVES * 2 + STANDS * 3)
    assert len(box.process.asked) == 2
    assert box.problems == ["the answer to the stop before is dropped for this one"]


def test_a_stop_at_the_same_place_is_a_line_and_no_further_bag():
    box = Box()
    box.numbers = iter(["2026-11-30_09-06-12", "another"])
    round_trip = [(0.5, 0.4)] * 314
    box.drive(DRIVES + STANDS * 2 + round_trip + STANDS * 2 + DRIVES)
    assert len(box.process.asked) == 1
    assert list(box.folder.saved) == ["2026-11-30_09-06-12"]
    assert box.lines[0] == "the robot stood at (1.50, 0.00)"
    assert box.lines[-1] == "the robot stood at (1.50, -0.00) again, as at 09:06:12 (2 times)"


@pytest.mark.parametrize(
    ("problem", "words"),
    [
        (ApplrError("the disk is full"), "the disk is full"),
        (OverflowError("a number"), "OverflowError: a number (test_box.py, line "),
    ],
)
def test_a_lost_bag_is_one_line_and_the_next_one_is_written(problem, words):
    box = Box()
    box.folder.problem = problem
    box.drive(DRIVES + STANDS * 2 + DRIVES * 4)
    (line,) = box.problems
    assert line.startswith(f"the stop of 0 is lost: {words}")
    assert (box.box.problem, box.box.lost_count) == (line, 1)
    box.folder.problem = None
    box.drive(STANDS * 2 + DRIVES * 5, begin=21.0)
    assert list(box.folder.saved) == ["1"]
    assert (box.box.problem, box.box.lost_count) == ("", 1)


def test_somebody_may_ask_to_save():
    box = Box()
    # All who ask until the bag is written get the same one.
    assert box.box.save(BEGIN_S) == "0"
    assert box.box.save(BEGIN_S) == "0"
    box.drive(DRIVES)
    assert box.box.save(BEGIN_S + 3.0) == "0"
    box.drive(DRIVES * 3, begin=3.0)
    assert list(box.folder.saved) == ["0"]
    assert stop_in(box.folder.saved["0"]).kind == "was asked to save"
    assert box.box.stop_count == len(box.process.asked) == 1
    # The next bag has a time that the first one does not have.
    assert box.box.save(BEGIN_S + 11.9) == "1"


def test_the_bag_of_a_stop_is_not_that_of_somebody_who_asks():
    box = Box()
    box.drive(DRIVES + STANDS * 2)
    assert box.box.save(BEGIN_S + 9.0) == "1"
    box.drive(DRIVES * 4, begin=9.0)
    assert list(box.folder.saved) == ["0", "1"]
    assert [stop.kind for stop, _ in box.process.asked] == ["stood", "was asked to save"]


def test_without_messages_a_save_is_lost_in_one_line():
    box = Box()
    box.box.save(BEGIN_S)
    box.look(BEGIN_S + 20.0)
    (line,) = box.problems
    assert line.startswith("the stop of 0 is lost: no message came")


def test_a_clock_that_jumps_back_loses_no_stop_that_was_found():
    box = Box()
    box.drive(DRIVES + STANDS * 2)
    assert len(box.process.asked) == 1
    box.take_scan(9.0)
    # The bag has what came until the jump.
    box.drive(DRIVES, begin=-100.0)
    # It is one jump for all topics.
    box.take_scan(-97.0)
    (saved_messages,) = box.folder.saved.values()
    assert saved_messages[-1].time / SECOND == pytest.approx(BEGIN_S + 9.0, abs=0.1)
    # Stops are found as before, and their bags have the new time alone.
    box.drive(STANDS * 3 + DRIVES * 4, begin=-97.0)
    assert len(box.process.asked) == 2
    _, saved_messages = box.folder.saved.values()
    times = [message.time for message in saved_messages]
    assert times == sorted(times)
    assert times[0] == round((BEGIN_S - 100.0) * SECOND)


def test_a_message_that_waited_on_a_busy_computer_is_no_clock_that_jumps_back():
    box = Box()
    box.drive(DRIVES * 10)
    # The scan came before the last odometry, whose thread was faster.
    scan = box.take_scan(27.0)
    box.drive(STANDS * 2, begin=30.0)
    ((stop, messages),) = box.process.asked
    assert stop.kind == "stood"
    assert messages[0].time / SECOND == pytest.approx(stop.begin - 15.0, abs=0.1)
    assert scan in messages


def test_a_message_that_cannot_be_unpacked_is_kept_for_the_answer():
    box = Box()

    def fail():
        raise ValueError("cut")

    cut = RawMessage(round(BEGIN_S * SECOND), ODOMETRY, b"cut")
    with pytest.raises(ValueError, match="cut"):
        box.box.take(cut, TopicSource("odometry", {}), fail)
    box.box.save(BEGIN_S)
    box.look(BEGIN_S + 20.0)
    assert box.folder.saved["0"][1:] == [cut]


def test_what_somebody_asked_to_save_is_kept_when_the_clock_jumps_back_at_once():
    box = Box()
    box.drive(DRIVES * 2)
    assert box.box.save(BEGIN_S + 5.9) == "0"
    box.drive(DRIVES[:1], begin=-100.0, first_look=10.0)
    # This moment is not in the first bag.
    assert box.box.save(BEGIN_S - 100.0) == "1"
    box.drive(DRIVES, begin=-100.0, first_look=0.5)
    (saved_messages,) = box.folder.saved.values()
    # The bag has what came until the jump.
    assert saved_messages[-1].time / SECOND == pytest.approx(BEGIN_S + 5.95, abs=0.1)


def test_what_is_pending_is_written_at_the_end():
    box = Box()
    box.drive(DRIVES + STANDS * 2)
    box.box.end()
    assert list(box.folder.saved) == ["0"]
    assert not box.process.is_running


# -- the process -----------------------------------------------------------------------------------
READS = "import json, sys; bag = sys.stdin.buffer.read(); "
MESSAGES = [RawMessage(second * SECOND, ODOMETRY, b"x" * 100_000) for second in range(1, 20)]


def process_of(program):
    """Return the process that runs a Python program."""
    return AnswerProcess([sys.executable, "-c", program])


def answer_within(process, seconds):
    """Return the answer that comes within some time [s], or None."""
    due_time = time.monotonic() + seconds
    while time.monotonic() < due_time:
        answer = process.answer()
        if answer is not None:
            return answer
        time.sleep(0.02)
    return None


def test_the_process_gets_the_job_and_its_last_answer_counts(monkeypatch):
    # Beside busy processes, one of low priority may begin late.
    monkeypatch.setattr(answer_process, "PATIENCE_S", 20.0)
    prints = "print(1); print('no answer'); import os; print(json.dumps([len(bag), os.nice(0)]))"
    process = process_of(READS + prints)
    assert process.ask(MESSAGES) is False
    byte_count, niceness = answer_within(process, 20.0)
    assert byte_count > 19 * 100_000
    assert niceness >= 10
    assert process.answer() is None
    assert not process.is_running


def test_the_first_answer_is_given_if_the_last_one_takes_long(monkeypatch):
    monkeypatch.setattr(answer_process, "PATIENCE_S", 1.0)
    process = process_of(
        READS + "import time; print(json.dumps('early'), flush=True); time.sleep(3.0); "
        "print(json.dumps('late'))"
    )
    process.ask(MESSAGES)
    assert answer_within(process, 20.0) == "early"
    assert answer_within(process, 20.0) == "late"

    same = process_of(READS + "import time; print(1, flush=True); time.sleep(1.5); print(1)")
    same.ask(MESSAGES)
    assert answer_within(same, 20.0) == 1
    assert answer_within(same, 5.0) is None


def test_the_next_stop_ends_the_process_of_the_one_before(tmp_path, monkeypatch):
    monkeypatch.setattr(answer_process, "PATIENCE_S", 20.0)
    ends = tmp_path / "ends"
    leaves_a_line = f"open({str(ends)!r}, 'a').write(str(len(bag)))"
    process = process_of(READS + f"import time; print(len(bag)); time.sleep(0.5); {leaves_a_line}")
    slow = process_of("import time; time.sleep(60.0)")
    slow.ask(MESSAGES)
    assert slow.is_running
    slow.end()
    assert not slow.is_running

    process.ask(MESSAGES)
    # The bag of 2 MB does not fit into a pipe: its sender ends with the process.
    assert process.ask(MESSAGES[1:]) is True
    byte_count = answer_within(process, 20.0)
    assert byte_count < 19 * 100_000
    # Only the second one has come to its end.
    assert ends.read_text() == str(byte_count)


def test_a_process_that_does_not_end_is_killed(monkeypatch):
    monkeypatch.setattr(answer_process, "LONGEST_S", 0.2)
    process = process_of("import time; time.sleep(60.0)")
    process.ask(MESSAGES)
    assert answer_within(process, 1.0) is None
    assert not process.is_running
