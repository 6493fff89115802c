"""Answer of a robot in words: what happened, why, what may help, and how sure that is."""

from __future__ import annotations

from typing import Any, Iterable, List, Optional, Sequence

import numpy as np

from applr_ros1.why import events
from applr_ros1.why.alternatives import Alternative
from applr_ros1.why.diagnosis import Diagnosis, middle_of
from applr_ros1.why.events import Event
from applr_ros1.why.explanation import beside
from applr_ros1.why.replay import Replay
from applr_ros1.why.stretch import SLOW

GUESS_SHARE = 0.1  # share of the top speed that a guess gains at least


def what_happened(diagnosis: Diagnosis) -> str:
    """Return the first line: a contact, then where and when, what happened, and why."""
    if diagnosis.touch is not None:
        return f"{diagnosis.touch} {_what_stopped_it(diagnosis)}"
    return _what_stopped_it(diagnosis)


def _what_stopped_it(diagnosis: Diagnosis) -> str:
    """Return the longest event with place, time and reason, or that there was none."""
    if diagnosis.part is not None:
        place = beside(*diagnosis.part, digits=1)
        return f"The laser sees a part of the robot, {place} of its centre."
    if diagnosis.longest is not None:
        return f"{diagnosis.longest}{_why(diagnosis, diagnosis.longest)}."
    odometry = diagnosis.replay.recording.odometry
    top_speed = diagnosis.replay.top_speed
    mean_speed = float(np.abs(odometry.twist[:, 0]).mean())
    return (
        f"The robot did not stop: its mean speed is {mean_speed:.2f} m/s, "
        f"max_vel_x {top_speed:.2f} m/s."
    )


def headline(diagnosis: Diagnosis) -> str:
    """Return what happened as a sentence about the robot, for the top of a page."""
    event = diagnosis.longest
    if event is None or diagnosis.part is not None or diagnosis.touch is not None:
        return what_happened(diagnosis)
    happened = f"The robot {event.kind} from {event.begin:.1f} to {event.end:.1f} s"
    return f"{happened}{_why(diagnosis, event)}."


def _why(diagnosis: Diagnosis, event: Event) -> str:
    """Return the end of a sentence with the reason of an event.

    A moment that somebody asks about need not be a stop: what is known instead is said.
    """
    if event.reason:
        return f", because {event.reason}"
    if not event.is_asked:
        return ""
    replay = diagnosis.replay
    motion = replay.recording.odometry.between(event.begin, event.end)
    if not events.pursued(diagnosis.drive, motion).any():
        return ": it had no goal"
    top_speed = replay.top_speed
    if float(np.abs(motion.twist[:, 0]).mean()) >= SLOW * top_speed:
        return f": nothing held it up (max_vel_x {top_speed:.2f} m/s)"
    return ": the reason is not known"


def what_the_planner_weighed(diagnosis: Diagnosis) -> List[str]:
    """Return the explanation of a moment that somebody asks about; nothing of other events."""
    event = diagnosis.longest
    if event is None or not event.is_asked or diagnosis.part is not None:
        return []
    explained = diagnosis.explained[0]
    if not explained:
        return []
    explanation = middle_of(explained)
    return [f"The planner's choice at {explanation.at:.1f} s:", *indented(explanation.lines)]


def sentence(event: Event) -> str:
    """Return an event with its reason."""
    if not event.reason:
        return f"{event}."
    return f"{event}, because {event.reason}."


def best_guess(guesses: Sequence[Alternative], replay: Replay) -> Optional[Alternative]:
    """Return the first of the guesses of a replay.

    None if it gains too little of the top speed, or if the replay is not to be trusted.
    """
    if not guesses or replay.is_poor or guesses[0].gain < GUESS_SHARE * replay.top_speed:
        return None
    return guesses[0]


def certainty_of(replay: Replay) -> str:
    """Return how far the replay agrees with the recorded drive."""
    if not replay.doubt:
        return str(replay)
    return f"{replay}; {replay.doubt}"


def indented(items: Iterable[Any]) -> List[str]:
    """Return a line for each item, to be printed below a heading."""
    return [f"   {item}" for item in items]
