"""Datasets for offline training in Minari's format.

`bags_to_dataset` writes them, and `./applr train --dataset` reads them. Other libraries can read
the datasets with minari.load_dataset or minari.MinariDataset(FOLDER/data). This module reads them
with h5py, because Minari instantiates the environment named by a dataset, and a foreign dataset can
name anything.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any, Dict, Iterator, Sequence

import numpy as np

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import check_regular, read_json, reading
from training.env.trajectory import Trajectory, TransitionLayout

# Fewest transitions from which a policy can be expected to learn. The smallest dataset that was
# tried had 246.
FEWEST_TRANSITIONS = 200
# Names of files and folders in Minari's format
DATA = "data"
METADATA = "metadata.json"
EPISODES = "main_data.hdf5"


def write(
    folder: Path,
    layout: TransitionLayout,
    trajectories: Sequence[Trajectory],
    about: Dict[str, Any],
) -> None:
    """Write a dataset atomically.

    Args:
        folder: Parent of the new folder "data".
        layout: Layout of observations and actions.
        trajectories: Episodes of the dataset.
        about: Further metadata as JSON values: the settings with which the episodes were driven.
    """
    import minari
    from gymnasium.spaces import Box
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.minari_storage import MinariStorage

    folder = folder.absolute()  # Minari joins a relative path with itself.
    partial = folder / f"{DATA}.partial"
    shutil.rmtree(partial, ignore_errors=True)
    observations = Box(-np.inf, np.inf, (layout.size,))
    actions = Box(-1.0, 1.0, (layout.action,))
    storage = MinariStorage.new(partial, observations, actions)
    for trajectory in trajectories:
        # An episode ends with its last transition, either in a terminal state or by truncation.
        last = np.arange(len(trajectory)) == len(trajectory) - 1
        episode = EpisodeBuffer(
            observations=layout.restore(trajectory.scan, trajectory.rest),
            actions=trajectory.action,
            rewards=trajectory.reward,
            terminations=last & trajectory.terminated,
            truncations=last & (not trajectory.terminated),
        )
        storage.update_episodes([episode])
    storage.update_metadata(
        {
            "dataset_id": folder.name,
            "minari_version": minari.__version__,
            "layout": vars(layout),
            **about,
        }
    )
    partial.rename(folder / DATA)  # A dataset that exists is complete.


def describe(transitions: int, seconds: float) -> str:
    """Return a line on how much a dataset holds: transitions, and the duration of these [s]."""
    return f"{transitions} transitions in {seconds / 3600.0:.2g} h of driving"


class Dataset:
    """Dataset in a folder.

    Attributes:
        about: Metadata of the dataset.
        layout: Layout of observations and actions.
        transitions: Number of transitions.
        rows: Number of observations, one more than transitions for each episode.

    Raises:
        ApplrError: There is no dataset, or it cannot be read.
    """

    def __init__(self, folder: os.PathLike[str] | str):
        self._folder = Path(folder) / DATA
        if not self._folder.exists():
            raise ApplrError(f"{folder}: no dataset there; give the --out of bags_to_dataset.py")
        with reading(self._folder / METADATA):
            self.about = read_json(self._folder / METADATA)
            self.layout = TransitionLayout(**self.about["layout"])
            self.transitions = self.about["total_steps"]
            self.rows = self.transitions + self.about["total_episodes"]

    def trajectories(self) -> Iterator[Trajectory]:
        """Yield the episodes."""
        import h5py

        episodes_file = self._folder / EPISODES
        check_regular(episodes_file)
        with reading(episodes_file), h5py.File(episodes_file) as file:
            for number in range(self.about["total_episodes"]):
                episode = file[f"episode_{number}"]
                yield Trajectory.of(
                    self.layout,
                    observations=episode["observations"][()],
                    actions=episode["actions"][()],
                    rewards=episode["rewards"][()],
                    terminated=bool(episode["terminations"][-1]),
                )
