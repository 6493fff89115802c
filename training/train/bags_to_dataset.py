"""Converts recorded drives of the applr node into a dataset for offline training.

Run it as `rosrun applr_ros1 bags_to_dataset.py` or `python -m training.train.bags_to_dataset`.
ROS 1 bags and bags converted by `rosbags-convert`, from real robots and from simulation, can be
mixed.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence, Tuple

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.extras import extra
from applr_ros1.drives.columns import TopicNames
from applr_ros1.policy.decision import PERIOD
from applr_ros1.policy.dimensionless import ENCODINGS
from training.common.command_line import run_command
from training.common.folders import make_folder
from training.common.options import argument, option
from training.env.reward import Reward
from training.env.trajectory import Trajectory, TransitionLayout
from training.train.learner.config import RECIPES, TrainConfig, recipe
from training.train.replay import dataset

with extra(__name__):
    from training.bags.options import BagOptions
    from training.bags.read import BagError, bags_in, opened
    from training.train.transitions import COLUMNS, decision_period, transitions


class DatasetOptions(BagOptions):
    """Bags to convert, and options of the conversion."""

    # fmt: off
    bags: List[str] = argument(
        "Bags (.bag, .mcap), folders of a ROS 2 bag, or folders that hold bags.")
    out: str = option(..., "Folder for the dataset; it must not hold a dataset yet.")
    finish: Optional[float] = option(None,
        "Progress [m] towards the goal at which a course counts as finished, for example 5.925 on "
        "the paper's course. By default, the result of move_base decides.", ge=-1e6, le=1e6)
    recipe: str = option("",
        f"Recipe that gives the robot, the observation and the reward, as in ./applr train: "
        f"{', '.join(RECIPES)}, or a YAML file of options. Default: the paper's.")
    move_base: str = option(TopicNames.move_base,
        "Namespace of move_base in the bags, whose goals are read.")
    # fmt: on


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the command.

    Return 0, or 1 after a one-line error if no dataset was written.
    """
    return run_command(DatasetOptions, run, "bags_to_dataset.py", __doc__, arguments)


def run(options: DatasetOptions) -> None:
    """Write the dataset from the bags.

    Unreadable bags and incomplete episodes are skipped, reported and counted by reason.

    Raises:
        BagError: No transition is usable.
        ApplrError: The folder cannot be written.
    """
    learnt = TrainConfig(**recipe(options.recipe))
    if "robot" not in options.model_fields_set:
        options = options.model_copy(update={"robot": learnt.robot})
    robot = options.robot
    reward = Reward.of(learnt)
    topics = options.topics()
    bags = bags_in(options.bags)
    layout = TransitionLayout.of(ENCODINGS[learnt.observation](robot, PERIOD))
    folder = Path(options.out)
    if (folder / dataset.DATA).exists():
        raise ApplrError(f"{options.out} already holds a dataset: give another folder")

    # Episodes, and for each bag what it gave and why the rest cannot be used
    all_episodes: List[Trajectory] = []
    all_skipped: Counter[str] = Counter()
    periods = set()
    for bag in bags:
        episodes: List[Trajectory] = []
        skipped: Counter[str] = Counter()
        try:
            with opened(bag) as open_bag:
                recorded = open_bag.drive(robot, topics, COLUMNS)
                episodes, skipped = transitions(
                    recorded, robot, learnt.observation, reward, options.finish, topics
                )
                period = decision_period(recorded)
                if episodes and period is not None:
                    periods.add(period)
        except BagError as error:
            # The message begins with the bag's name; bags with the same problem count together.
            skipped[str(error).partition(": ")[2]] += 1
        all_episodes += episodes
        all_skipped += skipped
        count, stood = _size(episodes)
        reasons = "".join(f"; skipped {times}: {why}" for why, times in sorted(skipped.items()))
        print(f"{bag}: {count} transitions in {len(episodes)} episodes, {stood}{reasons}")
    if not all_episodes:
        raise BagError("no transition is usable: see the reasons above")
    if len(periods) > 1:
        listed = ", ".join(f"{period:g}" for period in sorted(periods))
        raise BagError(
            f"the bags differ in decision period [s], {listed}: give those of one period"
        )
    (only_period,) = periods or {PERIOD}

    # Settings that ./applr train compares with its options (dataset_of in learner/prepare.py)
    about: Dict[str, Any] = {"robot": robot.name, "observation": learnt.observation}
    about.update(reward.model_dump(), critics_know_more=False, skipped=all_skipped)
    about["bags"] = [bag.name for bag in bags]
    about["decision_period"] = round(only_period, 3)
    dataset.write(make_folder(folder), layout, all_episodes, about)
    count, stood = _size(all_episodes)
    print(f"{options.out}: {stood}; {dataset.describe(count, count * only_period)}")


def _size(episodes: Sequence[Trajectory]) -> Tuple[int, str]:
    """Return the number of transitions, and in words in how many of them the robot stood."""
    count = sum(map(len, episodes))
    stood = sum(episode.info["stood"] for episode in episodes)
    return count, f"the robot stood in {100 * stood / max(count, 1):.0f} % of the transitions"


if __name__ == "__main__":
    sys.exit(main())
