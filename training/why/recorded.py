"""Reads the recorded drive of a bag for the replay."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, Optional, TypeVar

from applr_ros1.drives.drive import Drive
from applr_ros1.drives.names import missing, names_in
from applr_ros1.why.black_box.description import TOPIC, DescribedRobot, described_by
from applr_ros1.why.diagnosis import Diagnosis
from applr_ros1.why.outside import (
    NO_PLAN,
    seen_from_outside,
    unknown_to_replay,
)
from applr_ros1.why.recorded import CHANNELS, recording_from, with_planned
from applr_ros1.why.recording import Recording
from applr_ros1.why.rerun import RerunPlanner
from training.bags.options import BagOptions
from training.bags.read import BagError, opened
from training.common.options import option


class BagAnswerOptions(BagOptions):
    """Options of the answer to a recorded drive."""

    move_base: str = option("", "Namespace of move_base in the bag. Default: that of its plans.")
    quick: bool = option(
        False, "Leave out the drives in simulation: only the replay ranks changes of parameters."
    )


SomeOptions = TypeVar("SomeOptions", bound=BagAnswerOptions)


class NotReplayedError(BagError):
    """Error of a bag of which only what is seen from outside is known: its diagnosis."""

    def __init__(self, path: Path, diagnosis: Diagnosis):
        super().__init__(f"{path}: {diagnosis.note}")
        self.diagnosis = diagnosis


def described_in(path: Path) -> Optional[DescribedRobot]:
    """Return what the black box describes in its bag; None in other bags."""
    with opened(path) as bag:
        text = bag.text_on(TOPIC)
        return described_by(text, path.name) if text is not None else None


def with_description(path: Path, options: SomeOptions) -> SomeOptions:
    """Return options with the robot and the topics that the black box describes in its bag.

    What a person gave stays. Of a robot whose body nobody knows, nothing is driven in simulation.
    """
    described = described_in(path)
    if described is None:
        return options
    found = {"robot": described.robot, **vars(described.topics)}
    update: Dict[str, Any] = {}
    for option_name, value in found.items():
        if option_name in type(options).model_fields:
            update[option_name] = value
    if not described.is_known:
        update["quick"] = True
    for option_name in options.model_fields_set:
        update.pop(option_name, None)
    if "robot" in options.model_fields_set:
        update.pop("quick", None)
    return options.model_copy(update=update)


def recording_of(
    path: Path, options: BagAnswerOptions, planner: Optional[RerunPlanner]
) -> Recording:
    """Read the drive in a bag, with columns that fit on each other.

    Args:
        path: The bag.
        options: Robot and names of topics.
        planner: Planner of the robot, which cuts the global planner's plans; None if it is not
            replayed.

    Raises:
        NotReplayedError: A local planner drove that is not replayed, or the global planner found no
            plan.
        BagError: The bag cannot be read, lacks odometry, scans, commands or plans, another robot or
            planner drove, or the frames of its messages do not fit.
    """
    robot = options.robot
    with opened(path) as bag:
        # Topics that are options are not looked for.
        types = bag.types
        names = names_in(types, options.topics(), options.given_topics())
        drive = with_planned(bag.drive(robot, names, (*CHANNELS, "contacts"), is_one=True), robot)
        # The black box records all plans, so that none was found if its bag has none.
        has_recorded_plans = bool(drive.plans or drive.routes) or TOPIC in types
        note = unknown_to_replay(drive, robot, types)
        if not note and has_recorded_plans and not has_plan(drive):
            note = NO_PLAN
        if not note:
            return recording_from(drive, names, types, planner, robot)
    # Outside the block, whose errors would become others without the drive
    if drive.odometry is None:
        problem = missing("odometry", names, types)
        raise BagError(f"{path}: {note}; what else happened is seen in the odometry: {problem}")
    box = described_in(path)
    raise NotReplayedError(path, seen_from_outside(drive, drive.odometry, robot, note, box))


def has_plan(drive: Drive) -> bool:
    """Return whether a plan of a drive is not empty."""
    return any(rows and any(map(len, rows.path)) for rows in (drive.plans, drive.routes))
