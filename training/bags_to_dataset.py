"""Converts recorded drives to a dataset for offline training.

Started as `rosrun applr_ros1 bags_to_dataset.py` or `python -m training.bags_to_dataset`. Bags of ROS 1 and ROS 2, from
real robots and from simulation, can be mixed.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from typing import Any, Dict, List, Optional

from applr_ros1.common.errors import ApplrError, reason, run_main
from applr_ros1.common.extras import extra
from applr_ros1.policy.form import PaperForm
from training.common.command_line import parsed
from training.common.folders import make_folder
from training.common.options import argument, checked, option
from training.env.reward import Reward
from training.replay.store import NAME, TrajectoryStore
from training.replay.trajectory import MAX_NAME, TrajectoryError, TransitionLayout

with extra(__name__):
    from training.bags.episodes import BagReport, trajectories
    from training.bags.reader import BagError, BagOptions, TopicNames, find, read_bag


def _reasons(skipped) -> str:
    return "".join(f"; skipped {count}: {why}" for why, count in sorted(skipped.items()))


class DatasetOptions(BagOptions):
    """What to convert."""

    # fmt: off
    bags: List[str] = argument("Bags (.bag, .mcap), folders of a ROS 2 bag, or folders that hold bags.")
    out: str = option(..., "Folder for the dataset; it must not hold one already.")
    finish: Optional[float] = option(None,
        "Progress [m] towards the goal at which a course counts as finished; 5.925 on the paper's course. Without it "
        "the result of move_base decides.", ge=-1e6, le=1e6)
    reward: List[str] = option([],
        "Coefficient of the reward to use instead of its default, as NAME=VALUE; can be given several times. Names: "
        f"{', '.join(Reward.model_fields)}.")
    plan: str = option(TopicNames.plan, "Topic of the global plans in the bags.")
    move_base: str = option(TopicNames.move_base,
        "Name space of move_base in the bags, with its goals and the parameters of its servers.")
    applr: str = option(TopicNames.applr,
        "Name space of the applr node in the bags, with whose observations the rebuilt ones are compared.")
    # fmt: on


def main(arguments=None) -> int:
    """Exit status 0; 1 with one line when no dataset could be made."""
    name = "bags_to_dataset"
    return run_main(lambda: run(parsed(DatasetOptions, f"{name}.py", __doc__, arguments)), name)


def run(options: DatasetOptions) -> None:
    """Writes the dataset from the bags.

    A bag or episode that is damaged or incomplete is skipped, printed and counted under its reason. Raises BagError
    when nothing at all could be used, StorageError when the folder cannot be written.
    """
    reward = checked(Reward, dict(text.partition("=")[::2] for text in options.reward), "--reward")
    topics = options.topics()
    bags, form = find(options.bags), PaperForm(options.robot)
    layout = TransitionLayout(form.scan, form.size - form.scan, form.actions)
    store = TrajectoryStore(make_folder(options.out) / NAME, layout)
    if store.last:
        raise ApplrError(f"{options.out}: holds trajectories already; give another folder")
    reports: List[BagReport] = []
    for bag in bags:
        reports.append(report := BagReport())
        try:
            recording = read_bag(bag, topics, options.robot)
            if recording.silent:
                print(f"{bag}: {recording.silent}")
            for trajectory in trajectories(recording, reward, layout, report, options.finish):
                trajectory.info.update(actor=bag.name[-MAX_NAME:], episode=store.last)
                trajectory.check(layout)
                store.append(trajectory)
        except BagError as error:
            report.skipped[str(error).partition(": ")[2].partition(" (")[0]] += 1
            print(error)
        except TrajectoryError as error:
            report.skipped[str(error)] += 1
            print(error)
        except Exception as error:  # a message deep inside a damaged bag: rosbags raises many kinds
            report.skipped["damaged inside"] += 1
            print(f"{bag}: damaged inside ({reason(error)})")
        print(
            f"{bag}: {report.transitions} transitions in {report.episodes} episodes, {report.verified} observations "
            f"equal to the node's{_reasons(report.skipped)}"
        )
    skipped = sum((report.skipped for report in reports), Counter())
    if not store.transitions:
        store.close()
        (Path(options.out) / NAME).unlink()
        if not any(Path(options.out).iterdir()):
            Path(options.out).rmdir()
        raise BagError(f"no transition could be used{_reasons(skipped)}")
    about = ("episodes", "verified", "transitions", "skipped")
    read = [{"name": bag.name, **{name: vars(report)[name] for name in about}} for bag, report in zip(bags, reports)]
    source: Dict[str, Any] = {"bags": read, "robot": options.robot.name, **reward.model_dump()}
    periods = sorted(set().union(*(report.periods for report in reports)))
    if len(periods) == 1:
        source["decision_period"] = round(periods[0], 3)
    else:
        print(f"the decisions' periods differ: {', '.join(f'{period:g}' for period in periods)} s")
    store.note("source", source)
    store.note("skipped", skipped)
    print(f"{options.out}: {store.transitions} transitions")
    store.close()


if __name__ == "__main__":
    sys.exit(main())
