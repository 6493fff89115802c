"""Answers why a robot stopped, from the messages around the stop, without a desk.

What is seen from outside the planner is said first, because it is known at once and for every local
planner. The planner's own reason and the guess follow from a replay.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, Callable, Dict, Iterator, List, Optional, Sequence

from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.columns import SECOND
from applr_ros1.drives.drive import Drive
from applr_ros1.drives.received import all_received, drive_from, received, sources_of
from applr_ros1.why import events
from applr_ros1.why.alternatives import guesses_of
from applr_ros1.why.answer import best_guess
from applr_ros1.why.black_box.bag_file import Publication, RawMessage
from applr_ros1.why.black_box.description import (
    TOPIC,
    DescribedRobot,
    described_by,
    nobody_publishes,
)
from applr_ros1.why.black_box.stops import SAVED, RobotStop
from applr_ros1.why.diagnosis import Diagnosis, explain_event, give_outside_reason
from applr_ros1.why.events import Event
from applr_ros1.why.explanation import part_of_robot
from applr_ros1.why.outside import (
    OTHER_PLANNER,
    control_period,
    is_other_planner,
    seen_from_outside,
)
from applr_ros1.why.recorded import CHANNELS, recording_from, with_planned
from applr_ros1.why.replay import replay_of
from applr_ros1.why.rerun import RerunPlanner

NO_STOP = "it has not stopped"  # what is said if somebody asks too early
# Returns a message as an object.
Deserialize = Callable[[Publication, bytes], Any]


@dataclass(frozen=True)
class StopAnswer:
    """Answer why a robot stopped.

    Attributes:
        kind: What happened, in words.
        first_kind: What was said when the stop was found.
        begin: Begin [s, by the robot's clock].
        end: Time until which it had lasted [s, by the robot's clock].
        x: Place of the robot [m].
        y: Place of the robot [m].
        frame: Frame of the place.
        reason: Why, in words; "" if it is not known.
        parameter: Parameter of the planner's guess, as SERVER/NAME; "" without one.
        before: Its value.
        after: The value with which the planner would have driven on.
        reproduced: Share of the commands that the replay reproduces; 0 without a replay.
        note: What limits the answer; "" if nothing does.
    """

    kind: str
    first_kind: str
    begin: float
    end: float
    x: float
    y: float
    frame: str
    reason: str = ""
    parameter: str = ""
    before: float = 0.0
    after: float = 0.0
    reproduced: float = 0.0
    note: str = ""

    def __str__(self) -> str:
        seconds = self.end - self.begin
        sentence = f"the robot {self.kind}"
        # Somebody who asks to save has said nothing of the robot.
        if self.first_kind not in (SAVED, self.kind):
            sentence = f"the robot, which {self.first_kind} at first, {self.kind}"
        if seconds > 0.0:
            sentence += f" for {seconds:.0f} s"
        sentence += f" at ({self.x:.2f}, {self.y:.2f})"
        if self.reason:
            sentence += f", because {self.reason}"
        if self.parameter:
            sentence += f"; try {self.parameter} {self.before:g} -> {self.after:g}"
        # Of a planner it is said once, when the black box begins.
        if self.note and self.note != OTHER_PLANNER:
            sentence += f" ({self.note})"
        return sentence

    def values(self) -> Dict[str, Any]:
        """Return JSON values."""
        return {**asdict(self), "sentence": str(self)}


def answers_of(
    messages: Sequence[RawMessage], stop: RobotStop, deserialize: Deserialize
) -> Iterator[StopAnswer]:
    """Yield what is known of a stop at once, then with the planner's reason, then with its guess.

    Args:
        messages: Messages around the stop, with the description of the robot.
        stop: The stop.
        deserialize: Returns a message as an object.

    Raises:
        ApplrError: The messages have no description of a robot.
    """
    described_robot = _description(messages, deserialize)
    drive = _drive(messages, described_robot, deserialize)
    begin = messages[0].time / SECOND
    first_answer = StopAnswer(
        kind=stop.kind,
        first_kind=stop.kind,
        begin=stop.begin,
        end=stop.end,
        x=stop.place[0],
        y=stop.place[1],
        frame=drive.frame,
    )
    silence = nobody_publishes(described_robot.unpublished)
    if drive.odometry is None:
        no_odometry = f"there is no odometry on {described_robot.topics.odometry}"
        yield replace(first_answer, reason=silence or no_odometry)
        return
    robot = described_robot.robot
    event = _event_of(stop, begin, seen_from_outside(drive, drive.odometry, robot).events)
    if event.kind == SAVED:
        yield replace(first_answer, note=NO_STOP)
        return
    # A moment that is no event has no reason yet.
    give_outside_reason(event, drive, robot, control_period(drive, robot))
    # Whatever else stops a robot without its laser follows from that.
    if silence:
        event.reason = silence
        event.is_outside = True
    # The place stays in the frame of the odometry, which may not be that of the replay.
    x, y = event.place
    outside_answer = replace(_with_event(first_answer, event, begin), x=x, y=y)
    if is_other_planner(drive, robot):
        yield replace(outside_answer, note=OTHER_PLANNER)
        return
    yield outside_answer
    # A replay would tell nothing more of a reason that lies outside the planner.
    if event.is_outside:
        return
    try:
        yield from _replayed(outside_answer, messages, drive, described_robot, stop)
    except ApplrError as problem:
        yield replace(outside_answer, note=str(problem))


def _description(messages: Sequence[RawMessage], deserialize: Deserialize) -> DescribedRobot:
    for message in messages:
        if message.publication.topic == TOPIC:
            text = deserialize(message.publication, message.data).data
            return described_by(text, "stop")
    raise ApplrError(f"no message on {TOPIC}: start the black box beside move_base")


def _drive(
    messages: Sequence[RawMessage], described_robot: DescribedRobot, deserialize: Deserialize
) -> Drive:
    """Return the drive in messages."""
    sources = sources_of(_types(messages), described_robot.topics, CHANNELS)
    calls = []
    for time, publication, data in messages:
        source = sources.get(publication.topic)
        if source is not None:
            deserialized = partial(deserialize, publication, data)
            receive = partial(received, time, source, data, publication.md5sum, deserialized)
            calls.append((publication.topic, receive))
    received_messages = all_received(calls, "stop")
    drive = drive_from(received_messages, described_robot.robot)
    drive.name = "stop"
    return with_planned(drive)


def _types(messages: Sequence[RawMessage]) -> Dict[str, str]:
    """Return {topic: type} of messages."""
    return {message.publication.topic: message.publication.type for message in messages}


def _event_of(stop: RobotStop, begin: float, found_events: List[Event]) -> Event:
    """Return the event that is the stop.

    Args:
        stop: The stop.
        begin: Begin of the drive [s, by the robot's clock].
        found_events: Events of the drive.
    """
    stop_begin = stop.begin - begin
    stop_end = stop.end - begin
    best_overlap = 0.0
    best_event: Optional[Event] = None
    for event in found_events:
        overlap = min(event.end, stop_end) - max(event.begin, stop_begin)
        # Somebody who asks to save asks about the latest event.
        if stop.kind == SAVED:
            overlap = event.end
        if overlap > best_overlap:
            best_overlap = overlap
            best_event = event
    if best_event is not None:
        return best_event
    return Event(stop.kind, stop_begin - events.AROUND_S, stop_end, stop.place)


def _with_event(answer: StopAnswer, event: Event, begin: float) -> StopAnswer:
    """Return an answer with what is known of the event."""
    return replace(
        answer,
        kind=event.kind,
        begin=begin + event.begin,
        end=begin + event.end,
        reason=event.reason,
    )


def _replayed(
    answer: StopAnswer,
    messages: Sequence[RawMessage],
    drive: Drive,
    described_robot: DescribedRobot,
    stop: RobotStop,
) -> Iterator[StopAnswer]:
    """Yield the answer with the planner's reason and how true the replay is, then with its guess.

    Raises:
        ApplrError: The drive cannot be replayed.
    """
    robot = described_robot.robot
    topics = described_robot.topics
    planner = RerunPlanner(robot)
    recording = recording_from(drive, topics, _types(messages), planner, robot)
    replay = replay_of(recording, planner)
    if not replay.cycles:
        raise ApplrError("no command has a plan, a scan and odometry")
    begin = messages[0].time / SECOND
    found_events = events.find(replay.drive, recording.odometry, replay.limits)
    event = _event_of(stop, begin, found_events)
    explained = explain_event(replay, event)
    answer = replace(_with_event(answer, event, begin), reproduced=replay.share)
    if not event.is_outside:
        answer = replace(answer, note=replay.doubt)
    yield answer
    if event.is_outside:
        return
    part = part_of_robot(replay)
    guesses = guesses_of(Diagnosis(replay, [event], [explained], part))
    guess = best_guess(guesses, replay)
    if guess is None:
        return
    yield replace(
        answer,
        parameter=f"{guess.change.server}/{guess.change.name}",
        before=float(guess.change.before),
        after=float(guess.change.after),
    )
