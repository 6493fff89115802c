"""Converts recorded drives to a dataset for offline training.

Started as `rosrun applr_ros1 bags_to_dataset.py` or `python -m training.bags_to_dataset`. Bags of ROS 1 and ROS 2, from
real robots and from simulation, can be mixed.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from typing import Any, Dict, List, Optional, Set

from applr_ros1.common.errors import ApplrError, reason, run_main
from applr_ros1.common.extras import extra
from applr_ros1.policy.observation import sizes_of
from applr_ros1.robots import JACKAL, Robot
from training.common.command_line import parsed
from training.common.folders import make_folder
from training.common.options import argument, checked, option
from training.env.reward import Reward
from training.replay.store import NAME, TrajectoryStore
from training.replay.trajectory import MAX_NAME, TrajectoryError, TransitionLayout

with extra(__name__):
    from training.bags.episodes import BagReport, trajectories
    from training.bags.reader import BagError, BagOptions, TopicNames, find, read_bag


def convert(
    paths,
    folder,
    topics: TopicNames = TopicNames(),
    reward: Reward = Reward(),
    finish=None,
    say=print,
    robot: Robot = JACKAL,
) -> int:
    """Writes the dataset `folder` from bags (files, ROS 2 folders, or folders of them); returns how many transitions.

    A bag or episode that is damaged or incomplete is skipped, said and counted under its reason. Raises BagError when
    nothing at all could be used, StorageError when the folder cannot be written.
    """
    bags = find(paths)
    read_bags: List[Dict[str, Any]] = []
    source: Dict[str, Any] = {"bags": read_bags, "robot": robot.name, **reward.model_dump()}
    periods: Set[float] = set()
    skipped: Counter[str] = Counter()
    layout = TransitionLayout(*sizes_of(robot))
    store = TrajectoryStore(make_folder(folder) / NAME, layout)
    if store.last:
        raise ApplrError(f"{folder}: holds trajectories already; give another folder")
    for bag in bags:
        report = BagReport()
        try:
            for trajectory in trajectories(read_bag(bag, topics, robot), reward, layout, report, finish):
                trajectory.info.update(actor=Path(bag).name[-MAX_NAME:], episode=store.last)
                trajectory.check(layout)
                store.append(trajectory)
        except (BagError, TrajectoryError) as error:
            report.skip(str(error).partition(": ")[2].partition(" (")[0] if isinstance(error, BagError) else str(error))
            say(str(error))
        except Exception as error:  # a message deep inside a damaged bag: rosbags raises many kinds
            report.skip("damaged inside")
            say(f"{bag}: damaged inside ({reason(error)})")
        periods |= report.periods
        skipped += report.skipped
        read_bags.append(
            {
                "name": Path(bag).name,
                "episodes": report.episodes,
                "verified": report.verified,
                "transitions": report.transitions,
                "skipped": report.skipped,
            }
        )
        say(
            f"{bag}: {report.transitions} transitions in {report.episodes} episodes, {report.verified} observations "
            f"equal to the node's{_reasons(report.skipped)}"
        )
    if not any(b["transitions"] for b in read_bags):
        store.close()
        (Path(folder) / NAME).unlink()
        if not any(Path(folder).iterdir()):
            Path(folder).rmdir()
        raise BagError(f"no transition could be used{_reasons(skipped)}")
    if len(periods) == 1:
        source["decision_period"] = round(periods.pop(), 3)
    else:
        say(f"the decisions' periods differ: {', '.join(f'{period:g}' for period in sorted(periods))} s")
    store.note("source", source)
    store.note("skipped", skipped)
    transitions = store.transitions
    store.close()
    return transitions


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
    """Converts the bags that the options name."""
    coefficients = dict(text.partition("=")[::2] for text in options.reward)
    reward = checked(Reward, coefficients, "--reward")
    transitions = convert(options.bags, options.out, options.topics(), reward, options.finish, robot=options.robot)
    print(f"{options.out}: {transitions} transitions")


if __name__ == "__main__":
    sys.exit(main())
