"""Answer why a robot stopped: of the black box, of `./applr why`, and to each bag of a logbook.

Message, JSON, page and sentences are made of it. A logbook keeps it as it is, so that it has plain
values only.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any, Dict, Iterable, List, Optional, Sequence, Tuple

import numpy as np
from numpy.typing import ArrayLike

from applr_ros1.common.angles import Pose, transform_point
from applr_ros1.drives.columns import TopicNames, topic_of
from applr_ros1.drives.drive import Drive
from applr_ros1.planner.parameters.settings import Change
from applr_ros1.robots.geometry import bounding_box
from applr_ros1.why import events
from applr_ros1.why.alternatives import HEADING, Alternative
from applr_ros1.why.costmap_sources import sources_in
from applr_ros1.why.diagnosis import Diagnosis, usual_row
from applr_ros1.why.events import GAVE_UP, SAVED, Event
from applr_ros1.why.outside import OTHER_PLANNER
from applr_ros1.why.stretch import SLOW
from applr_ros1.why.touch import touch_of

GUESS_SHARE = 0.1  # share of the top speed that a guess gains at least
LISTED = 4  # number of further events, and of rows of what was tried
SCANS = 60  # number of scans in a page's map
CELL_M = 0.05  # distance of its points [m]
TRACK_S = 0.1  # interval between the positions of a driven path [s]
# What a reason rests on (Stop.msg)
SEEN = "seen"
REPLAYED = "replayed"
GUESSED = "guessed"
# Keys in COLUMNS of topics without which an answer knows less
INFORMATIVE = ("goals", "odometry", "transforms", "scans", "plans", "routes", "changes")
NO_CHANGE = Change("", "", 0.0, 0.0)
# Attributes of an answer that are JSON values of it as they are
AS_THEY_ARE = (
    "name",
    "advice",
    "sure",
    "confidence",
    "evidence",
    "notes",
    "remedies",
    "tried",
    "recorded",
    "alternatives",
    "map",
    "track",
    "top_speed",
    "plan",
    "goal",
    "footprint",
)
# How a simulated drive ended: whether it arrived, seconds, whether it was broken off, and time [s]
# and place x, y [m] of the robot
DriveValues = Tuple[bool, float, bool, List[List[float]]]


@dataclass(frozen=True)
class Answer:
    """Answer why a robot stopped in a drive.

    Attributes:
        name: Name of the drive.
        robot: Name of the robot.
        length: Length of the robot [m].
        scale: Size of the robot relative to the Jackal's.
        begin: Time at which the drive begins [s, by the clock of its recorder].
        frame: Frame of the places of a logbook, and of all places if the origin is zero.
        is_shared: Whether drives share the frame, as a map's. Odometry begins anew at each start.
        origin: Pose (x, y, yaw) of the drive's own frame in this one.
        notes: Sentences about the drive.

        events: Events in order of time.
        told_row: Row of the event that is told; -1 if the robot did not stop.
        first_kind: What a black box said when it found the stop; "" without a stop of one.
        first_line: What happened, with time and place, and why.
        track: Time [s], place x, y [m] and speed [m/s] of the robot.
        top_speed: Mean top speed that the planner allows [m/s].
        map: Places x, y [m] of what the laser saw; empty without a replay, as all that follows.
        plan: Places of the first plan.
        goal: Place of the goal that was pursued, or None.
        footprint: Corners of the robot.
        weighed: Lines about a moment that somebody asks about.

        commands: Number of recorded commands of the local planner.
        reproduced: Number of those that the replay reproduces.
        certainty: How far the replay, and drives in simulation, agree with the recorded drive.
        note: What limits the answer, as what could not be seen; "" if nothing does.
        evidence: Sentences on the topics on which the drive was seen, what could not be seen, and
            what to record next time; none of a simulated drive.

        advice: What to change, and what that did when it was driven.
        guess: The replay's best guess: the change that names it, and what changes with it.
        alternatives: All guesses of the replay in words, the best first.
        candidates: Changes that may be driven in simulation, the best first, each with its words.
        policy_decides: Whether the robot's policy decides in its simulated drives.
        drives: How simulated drives ended, by their keys. None for values that move_base refuses.
        remedies: What helped when it was driven, in words.
        tried: Values of what was driven.
        recorded: The same for the recorded values, or None.
        driven: Rows of what was driven, for a terminal.
    """

    name: str
    robot: str
    length: float
    scale: float
    begin: float
    frame: str
    is_shared: bool = False
    origin: Pose = (0.0, 0.0, 0.0)
    notes: Sequence[str] = ()

    events: Sequence[Event] = ()
    told_row: int = -1
    first_kind: str = ""
    first_line: str = ""
    track: Sequence[List[float]] = ()
    top_speed: float = 0.0
    map: Sequence[List[float]] = ()
    plan: Sequence[List[float]] = ()
    goal: Optional[Tuple[float, float]] = None
    footprint: Sequence[List[float]] = ()
    weighed: Sequence[str] = ()

    commands: int = 0
    reproduced: int = 0
    certainty: str = ""
    note: str = ""
    evidence: Sequence[str] = ()

    advice: Sequence[str] = ()
    guess: Tuple[Change, ...] = ()
    alternatives: Sequence[str] = ()
    candidates: Sequence[Tuple[Tuple[Change, ...], str]] = ()
    policy_decides: bool = False
    drives: Dict[str, Optional[DriveValues]] = field(default_factory=dict)
    remedies: Sequence[str] = ()
    tried: Sequence[Dict[str, Any]] = ()
    recorded: Optional[Dict[str, Any]] = None
    driven: Sequence[str] = ()

    @property
    def told(self) -> Event:
        """The event that is told, if the robot stopped."""
        return self.events[self.told_row]

    @property
    def is_replayed(self) -> bool:
        """True if the drive was replayed, so that its page can be drawn."""
        return self.commands > 0

    @property
    def share(self) -> float:
        """Share of the planner's commands that the replay reproduces; 0 without a replay."""
        return self.reproduced / self.commands if self.commands else 0.0

    @property
    def sure(self) -> str:
        """How sure the answer is, as a sentence."""
        return f"{self.certainty or self.note}."

    @property
    def confidence(self) -> str:
        """What the reason rests on: on what was SEEN, REPLAYED, or GUESSED by a poor replay."""
        is_seen = self.told_row < 0 or self.told.is_outside or not self.told.reason
        if is_seen or not self.is_replayed:
            return SEEN
        return GUESSED if self.told.is_guessed else REPLAYED

    @property
    def lines(self) -> List[str]:
        """The answer for a terminal: what happened, what to change, how sure, then the rest."""
        lines = [self.first_line, *self.advice, self.sure, *self.evidence, *self.weighed]
        other_events = [event for row, event in enumerate(self.events) if row != self.told_row]
        other_events.sort(key=lambda event: -event.seconds)
        lines += under("Other events", map(sentence, other_events[:LISTED]))
        return [
            *lines,
            *self.driven,
            *under(HEADING, self.alternatives[:LISTED]),
        ]

    @property
    def sentence(self) -> str:
        """The answer to a stop while the robot drives, without what was tried."""
        event = self.told
        words = f"the robot {event.kind}"
        # Somebody who asks to save has said nothing of the robot.
        if self.first_kind not in ("", SAVED, event.kind):
            words = f"the robot, which {self.first_kind} at first, {event.kind}"
        if self.first_kind == GAVE_UP != event.kind:
            words = f"the robot {self.first_kind}: it {event.kind}"
        if round(event.seconds):
            words += f" for {event.seconds:.0f} s"
        x, y = event.place
        words += f" at ({x:.2f}, {y:.2f}){_because(event)}"
        if self.guess:
            change = self.guess[0]
            values = f"{float(change.before):g} -> {float(change.after):g}"
            words += f"; the replay's guess: {change.path} {values}"
        # Of a planner it is said once, when the black box begins.
        if self.note and self.note != OTHER_PLANNER:
            words += f" ({self.note})"
        return words

    def values(self) -> Dict[str, Any]:
        """Return JSON values, for programs and for the page."""
        return {
            **{name: getattr(self, name) for name in AS_THEY_ARE},
            "lines": self.lines,
            "reproduced": self.share,
            "events": list(map(values_of, self.events)),
        }

    def message(self) -> Dict[str, Any]:
        """Return the fields of applr_ros1/Stop about the event that is told, as JSON values.

        The fields of its header are `begin` [s, by the robot's clock] and `frame`.
        """
        event = self.told
        x, y = event.place
        change = self.guess[0] if self.guess else NO_CHANGE
        return {
            "begin": self.begin + event.begin,
            "frame": self.frame,
            "kind": event.kind,
            "seconds": event.seconds,
            "x": x,
            "y": y,
            "reason": event.reason,
            "sentence": self.sentence,
            "reproduced": self.share,
            "confidence": self.confidence,
            "note": self.note,
            "parameter": change.path,
            "before": float(change.before),
            "after": float(change.after),
        }

    def placed(self, points: ArrayLike) -> np.ndarray:
        """Return points (n, 2) [m] of the drive's own frame in the frame of a logbook."""
        x, y = transform_point(self.origin, *np.reshape(points, (-1, 2)).T)
        return np.column_stack([x, y])


# -- from a diagnosis ------------------------------------------------------------------------------
def answer_of(diagnosis: Diagnosis, guesses: Sequence[Alternative] = ()) -> Answer:
    """Return the answer of a diagnosis.

    Args:
        diagnosis: What happened, and why.
        guesses: Alternatives that the replay ranks, the best first. They were not driven.
    """
    drive = diagnosis.drive
    motion = diagnosis.motion
    told = diagnosis.told
    if told is None:
        mean_speed = float(np.abs(motion.twist[:, 0]).mean())
        first_line = (
            f"The robot did not stop: its mean speed is {mean_speed:.2f} m/s, "
            f"max_vel_x {diagnosis.top_speed:.2f} m/s."
        )
    else:
        first_line = f"{told}{_ending(diagnosis, told)}."
    # The measured motion, not the commands: a robot that stands may be told to drive.
    track = np.column_stack([motion.time, motion.pose[:, :2], motion.twist[:, 0]])
    box = bounding_box(diagnosis.robot)
    answer = Answer(
        name=drive.name,
        robot=diagnosis.robot.name,
        length=box.front - box.back,
        scale=diagnosis.robot.world_scale,
        begin=drive.recorded_at,
        frame=drive.frame,
        notes=drive.notes,
        events=diagnosis.events,
        told_row=diagnosis.events.index(told) if told is not None else -1,
        first_line=first_line,
        track=thinned(track),
        top_speed=diagnosis.top_speed,
        note=diagnosis.note,
        evidence=_evidence(diagnosis),
    )
    if diagnosis.replayed is None:
        return answer
    return _with_replay(answer, diagnosis, guesses)


def _evidence(diagnosis: Diagnosis) -> List[str]:
    """Return what the drive was seen on, what could not be seen, and what to record next time."""
    topics = diagnosis.drive.topics
    if not topics:
        return []
    sentences = [f"Seen on {', '.join(topics)}."]
    names = TopicNames.of(diagnosis.robot)
    missing = [topic_of(key, names) for key in INFORMATIVE if key not in topics.values()]
    if missing:
        sentences.append(f"Not recorded: {', '.join(missing)}: record them next time.")
    if diagnosis.replayed is not None:
        others = sources_in(diagnosis.robot).others
        if others:
            sentences.append(f"The local costmap also sees {', '.join(others)}: not replayed.")
    return sentences


def _with_replay(answer: Answer, diagnosis: Diagnosis, guesses: Sequence[Alternative]) -> Answer:
    """Return an answer with what the replay shows."""
    replay = diagnosis.replay
    told = diagnosis.told
    # The map: points of some scans, one for each cell
    chosen_scans = np.linspace(0, len(replay.recording.scans) - 1, SCANS).astype(int)
    clouds = [replay.cloud(index).points[:, :2] for index in chosen_scans]
    cells = np.unique(np.rint(np.concatenate(clouds) / CELL_M), axis=0)

    # Somebody who asks about a moment does not ask about the contact.
    first_line = answer.first_line
    touch = touch_of(replay.recording)
    if touch is not None and not (told is not None and told.is_asked):
        first_line = f"{touch} {first_line}"
    doubt = diagnosis.doubt
    goal = diagnosis.goal
    guess = best_guess(diagnosis, guesses)
    footprint = replay.footprint
    return replace(
        answer,
        first_line=first_line,
        length=float(np.ptp(footprint[:, 0])),
        map=(cells * CELL_M).round(2).tolist(),
        plan=_first_plan(replay.drive)[:, :2].round(2).tolist(),
        goal=goal.pose[:2] if goal is not None else None,
        footprint=footprint.round(3).tolist(),
        weighed=_weighed(diagnosis),
        commands=len(replay.cycles),
        reproduced=replay.reproduced,
        certainty=diagnosis.certainty,
        # The planner says nothing of a stop whose reason lies outside of it.
        note="" if told is not None and told.is_outside else doubt,
        advice=_advice(diagnosis, guess),
        guess=guess.changes if guess is not None else (),
        alternatives=list(map(str, guesses)),
    )


def _ending(diagnosis: Diagnosis, event: Event) -> str:
    """Return the end of a sentence with the reason of the event that is told.

    A moment that somebody asks about need not be a stop: what is known instead is said.
    """
    if event.reason or not event.is_asked:
        return _because(event)
    motion = diagnosis.motion.between(event.begin, event.end)
    if not events.pursued(diagnosis.drive, motion).any():
        return ": it had no goal"
    if float(np.abs(motion.twist[:, 0]).mean()) >= SLOW * diagnosis.top_speed:
        return f": nothing held it up (max_vel_x {diagnosis.top_speed:.2f} m/s)"
    return ": the reason is not known"


def _weighed(diagnosis: Diagnosis) -> List[str]:
    """Return the explanation of a moment that somebody asks about; nothing of other events."""
    event = diagnosis.told
    if event is None or not event.is_asked or not event.cycles or diagnosis.part is not None:
        return []
    cycle = event.cycles[usual_row(event.cycles)]
    return under(f"The planner's choice at {cycle['at']:.1f} s", cycle["lines"])


def _advice(diagnosis: Diagnosis, guess: Optional[Alternative]) -> List[str]:
    """Return what to change by the replay.

    There is nothing for a drive without events, and for a moment that somebody asks about.
    """
    event = diagnosis.told
    if event is None or event.is_asked or diagnosis.part is not None:
        return []
    if not diagnosis.wants_remedy:
        return ["No change was tried: the robot lost little time."]
    return [guess_in_words(guess.change)] if guess is not None else []


def best_guess(diagnosis: Diagnosis, guesses: Sequence[Alternative]) -> Optional[Alternative]:
    """Return the first of the guesses of a replay.

    None if it gains too little of the top speed, or if the replay is not to be trusted.
    """
    if not guesses or diagnosis.doubt:
        return None
    if guesses[0].gain < GUESS_SHARE * diagnosis.top_speed:
        return None
    return guesses[0]


def _first_plan(drive: Drive) -> np.ndarray:
    """Return the first plan (n, 3) to the goal, or that was followed; (0, 3) without a plan."""
    for plans in (drive.routes, drive.plans):
        if plans is not None:
            for plan_path in plans.path:
                if len(plan_path):
                    return plan_path
    return np.empty((0, 3))


def thinned(track: np.ndarray, interval: float = TRACK_S) -> List[List[float]]:
    """Return rows of a track (n, k), whose first column is the time [s], one in each interval."""
    steps = np.floor(track[:, 0] / interval)
    _, first_rows = np.unique(steps, return_index=True)
    # float32 rows of a simulated path would be printed with all their digits.
    thinned = track[first_rows].astype(np.float64)
    rows: List[List[float]] = np.round(thinned, 2).tolist()
    return rows


# -- in words --------------------------------------------------------------------------------------
def _because(event: Event) -> str:
    """Return the reason of an event as the end of a sentence; "" if it is not known."""
    because = "perhaps because" if event.is_guessed else "because"
    return f", {because} {event.reason}" if event.reason else ""


def sentence(event: Event) -> str:
    """Return an event with its reason."""
    return f"{event}{_because(event)}."


def guess_in_words(guess: Change) -> str:
    """Return the replay's best guess as a sentence."""
    return f"The replay's guess: {guess}."


def values_of(event: Event) -> Dict[str, Any]:
    """Return an event as JSON values."""
    return {
        **asdict(event),
        "title": str(event),
        "begin": round(event.begin, 2),
        "end": round(event.end, 2),
        "place": [round(coordinate, 3) for coordinate in event.place],
    }


def under(heading: str, items: Iterable[Any]) -> List[str]:
    """Return a heading and a line for each item; nothing without items."""
    rows = indented(items)
    return [f"{heading}:", *rows] if rows else []


def indented(items: Iterable[Any]) -> List[str]:
    """Return a line for each item, to be printed below a heading."""
    return [f"   {item}" for item in items]
