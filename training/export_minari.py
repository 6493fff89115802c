"""Exports experience as a Minari dataset: `python -m training.export_minari FOLDER ID`, for offline learning elsewhere.

FOLDER is a training run or a dataset of this package, of any robot or environment; ID is the new dataset's name, such
as jackal/applr-v0. It needs the package minari with its extra hdf5. The scans have the resolution in which they were
stored (7.8 mm).
"""

from __future__ import annotations

import itertools
import os
import sys
import warnings
from pathlib import Path
from typing import List, Optional

import numpy as np

from applr_ros1.common.errors import ApplrError, reason, run_main
from training.common.command_line import parsed
from training.common.options import Options, argument, option
from training.replay.store import Store
from training.replay.trajectory import Trajectory

AT_ONCE = 500  # episodes that are held in memory


class MinariOptions(Options):
    """What to export."""

    folder: str = argument("Folder of a training run or of a dataset.")
    id: str = argument("Name of the Minari dataset, NAME-vNUMBER, with namespaces before it if you like.")
    root: str = option("", "Folder of Minari's datasets. Without it Minari's own, MINARI_DATASETS_PATH.")


def main(arguments: Optional[List[str]] = None) -> int:
    """The command. Exit status 0; 1 with one line on stderr where nothing can be exported."""
    program = "python -m training.export_minari"
    return run_main(lambda: _export(parsed(MinariOptions, program, __doc__, arguments)), "export_minari")


def _export(options: MinariOptions) -> None:
    if options.root:
        os.environ["MINARI_DATASETS_PATH"] = str(Path(options.root).resolve())
    made = export(options.folder, options.id)
    print("%s: %d episodes, %d steps" % (options.id, made.total_episodes, made.total_steps))


def export(folder: str, name: str):
    """Write the episodes of a run or dataset into a new Minari dataset, and return it.

    Args:
        folder: of the run or dataset.
        name: of the Minari dataset.

    Raises:
        ApplrError: Minari is not installed or refuses the name, or there are no episodes.
        StorageError: the folder holds no trajectories, or they are damaged.
    """
    try:
        import gymnasium
        import h5py  # noqa: F401 - what Minari stores with
        import minari
        from minari.data_collector import EpisodeBuffer
    except ImportError as missing:
        raise ApplrError('minari is missing (%s): pip install "minari[hdf5]"' % reason(missing)) from None

    store = Store(folder)
    layout = store.layout

    def buffer(number: int, t: Trajectory) -> EpisodeBuffer:
        last = np.arange(len(t)) == len(t) - 1
        return EpisodeBuffer(
            id=number,
            observations=layout.restore(t.scan, t.rest),
            actions=t.action,
            rewards=t.reward.astype(np.float64),
            terminations=last & t.terminated,
            truncations=last & (not t.terminated),
        )

    episodes = enumerate(trajectory for _, trajectory in store.trajectories())
    first = [buffer(*e) for e in itertools.islice(episodes, AT_ONCE)]
    if not first:
        raise ApplrError("%s: holds no episodes" % folder)
    warnings.filterwarnings("ignore", category=UserWarning, module="minari")  # that author and such are not named
    try:
        made = minari.create_dataset_from_buffers(
            name,
            first,
            observation_space=gymnasium.spaces.Box(-1.0, 1.0, (layout.size,), np.float32),
            action_space=gymnasium.spaces.Box(-1.0, 1.0, (layout.action,), np.float32),
            description="Decisions over planner parameters, exported from %s." % Path(folder).resolve().name,
        )
    except ValueError as error:
        raise ApplrError("%s: %s" % (name, reason(error))) from None
    while more := [buffer(*e) for e in itertools.islice(episodes, AT_ONCE)]:
        made.update_dataset_from_buffer(more)
    return made


if __name__ == "__main__":
    sys.exit(main())
