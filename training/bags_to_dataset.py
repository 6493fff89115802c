"""Converts recorded drives with the applr node to a dataset for offline training.

Started as `rosrun applr_ros1 bags_to_dataset.py` or `python -m training.bags_to_dataset`. Bags of ROS 1, those that
`rosbags-convert` made of them, from real robots and from simulation, can be mixed.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from typing import Any, Dict, List, Optional

from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.extras import extra
from applr_ros1.policy.form import PaperForm
from training.common.command_line import parsed
from training.common.folders import make_folder
from training.common.options import argument, checked, option
from training.env.reward import Reward
from training.replay.store import NAME, TrajectoryStore
from training.replay.trajectory import MAX_NAME, TransitionLayout

with extra(__name__):
    import rosbags  # noqa: F401 - the child process that reads a bag needs it

    from training.bags.bag import BagError, BagOptions, bags_in, read, refused
    from training.bags.episodes import BagReport, transitions
    from training.bags.topics import TopicNames


def _reasons(skipped) -> str:
    return "".join(f"; skipped {count}: {why}" for why, count in sorted(skipped.items()))


class DatasetOptions(BagOptions):
    """The bags to convert, and how."""

    # fmt: off
    bags: List[str] = argument("Bags (.bag, .mcap), folders of a ROS 2 bag, or folders that hold bags.")
    out: str = option(..., "Folder for the dataset; it must not hold one already.")
    finish: Optional[float] = option(None,
        "Progress [m] towards the goal at which a course counts as finished; 5.925 on the paper's course. Without it "
        "the result of move_base decides.", ge=-1e6, le=1e6)
    reward: List[str] = option([],
        "Coefficient of the reward to use instead of its default, as NAME=VALUE; can be given several times. Names: "
        f"{', '.join(Reward.model_fields)}.")
    move_base: str = option(TopicNames.move_base,
        "Name space of move_base in the bags, with its goals.")
    applr: str = option(TopicNames.applr,
        "Name space of the applr node in the bags, with its decisions.")
    # fmt: on


def main(arguments=None) -> int:
    """Return exit status 0; 1 with one line when no dataset could be made."""
    name = "bags_to_dataset"
    return run_main(lambda: run(parsed(DatasetOptions, f"{name}.py", __doc__, arguments)), name)


def run(options: DatasetOptions) -> None:
    """Write the dataset from the bags.

    A bag or episode that is damaged or incomplete is skipped, printed and counted under its reason. Raises BagError
    when nothing at all could be used, StorageError when the folder cannot be written.
    """
    reward = checked(Reward, dict(text.partition("=")[::2] for text in options.reward), "--reward")
    topics = options.topics()
    bags, form = bags_in(options.bags), PaperForm(options.robot)
    layout = TransitionLayout(form.scan, form.size - form.scan, form.actions)
    store = TrajectoryStore(make_folder(options.out) / NAME, layout)
    if store.last:
        raise ApplrError(f"{options.out}: holds trajectories already; give another folder")
    reports: List[BagReport] = []
    for bag in bags:
        reports.append(report := BagReport())
        try:
            with refused(bag):
                recorded = read(bag, topics, ranges=False)
                found = list(transitions(recorded, options.robot, reward, layout, report, options.finish))
                for trajectory in found:
                    trajectory.check(layout)
        except BagError as error:
            found = []
            report.skipped[str(error).partition(": ")[2].partition(" (")[0]] += 1
            print(error)
        for trajectory in found:
            trajectory.info.update(actor=bag.name[-MAX_NAME:], episode=store.last)
            store.append(trajectory)
        skipped = _reasons(report.skipped)
        print(f"{bag}: {report.transitions} transitions in {report.episodes} episodes{skipped}")
    all_skipped = sum((report.skipped for report in reports), Counter())
    if not store.transitions:
        store.close()
        (Path(options.out) / NAME).unlink()
        if not any(Path(options.out).iterdir()):
            Path(options.out).rmdir()
        raise BagError(f"no transition could be used{_reasons(all_skipped)}")
    about = ("episodes", "transitions", "skipped")
    made = [{"name": bag.name, **{name: vars(report)[name] for name in about}} for bag, report in zip(bags, reports)]
    source: Dict[str, Any] = {"bags": made, "robot": options.robot.name, **reward.model_dump()}
    periods = sorted(set().union(*(report.periods for report in reports)))
    if len(periods) == 1:
        source["decision_period"] = round(periods[0], 3)
    else:
        print(f"the decisions' periods differ: {', '.join(f'{period:g}' for period in periods)} s")
    store.note("source", source)
    store.note("skipped", all_skipped)
    print(f"{options.out}: {store.transitions} transitions")
    store.close()


if __name__ == "__main__":
    sys.exit(main())
