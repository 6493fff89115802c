"""The one learner: takes trajectories, keeps them (replay, journal), and makes the gradient steps due for them.

train.py runs it. What it becomes depends only on its seed and on the trajectories in the order of their taking: a run
that was killed goes on from its last checkpoint, through the journal, to the very same numbers.
"""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Dict, Optional, Tuple

import numpy as np
import safetensors.numpy

from applr_ros1.common.files import StorageError, read_bytes, read_json, sha256, write_bytes, write_json
from applr_ros1.common.tally import Tally
from applr_ros1.common.tensors import unpack
from training.experience.journal import Journal
from training.experience.replay import Replay
from training.experience.trajectory import Layout, Trajectory, TrajectoryError
from training.gorila.batch import draw_batch
from training.storage import make_folder
from training.td3.td3 import TD3, LearnerError, TD3Config

FORMAT = "applr-checkpoint-1"
DATASET = "dataset"  # the actor by whose name a dataset's episodes are taken


@dataclass(frozen=True)
class LearnerConfig:
    """How much is kept, when gradient steps are due, and TD3's own options."""

    td3: TD3Config = TD3Config()
    capacity: int = 5_500_000  # rows of the replay: the paper's five million transitions, with last states
    updates_per_transition: float = 0.1  # one gradient step per ten transitions, as the authors' code
    warmup: int = 0  # transitions before the first gradient step
    mirror: bool = False  # half of each batch mirrored: APPLR's observations only (Replay.sample)
    max_staleness: int = 0  # refuse trajectories of policies older than so many updates; 0: never
    seed: int = 0
    device: str = "cpu"
    start: Tuple[float, ...] = ()  # the action at which the policy begins; (): that of its random first weights
    start_run: str = ""  # folder of a run with whose networks and optimisers this one begins; "": with random weights


class Learner:
    """folder: the run's; checkpoint.json, learner-*.safetensors and journal/ lie in it. None: nothing is kept."""

    def __init__(self, layout: Layout, config: LearnerConfig, folder: os.PathLike | str | None = None):
        self.layout, self.config = layout, config
        self.folder = Path(folder) if folder is not None else None
        self.td3 = TD3(layout.size, layout.action, config.td3, config.seed, config.device, layout.scan)
        if config.start:
            self.td3.begin_at(config.start)
        if config.start_run and (folder is None or self.saved(folder) is None):
            self._begin_with(Path(config.start_run))
        self.replay = Replay(layout, config.capacity)
        self.rng = np.random.default_rng([config.seed, 1])
        self.journal = Journal(make_folder(self.folder / "journal")) if self.folder is not None else None
        self.episodes = 0
        self.given = 0  # transitions that came from a dataset
        self.refused = Tally()  # trajectories, by reason
        self.staleness = Staleness()
        self.checkpoints = 0
        self._pace = (config.warmup, 0)  # of _counted and updates, from where updates_per_transition counts

    # -- taking ------------------------------------------------------------------------------------
    def take(self, blob: bytes) -> Optional[Trajectory]:
        """One packed trajectory from an actor. Malformed, repeated or too old ones are counted and dropped: None."""
        try:
            trajectory = Trajectory.unpack(blob)
            self.replay.check(trajectory)
            self._check_age(trajectory)
        except TrajectoryError as error:
            self.refused.add(str(error))
            return None
        if self.journal is not None:
            self.journal.append(
                blob, {"rows": self.replay.written, "transitions": self.replay.transitions, "episodes": self.episodes}
            )
        self.replay.add(trajectory)
        self._count(trajectory)
        return trajectory

    def _count(self, trajectory: Trajectory) -> None:
        self.episodes += 1
        self.given += len(trajectory) if trajectory.info["actor"] == DATASET else 0
        self.staleness.add(self.td3.updates - trajectory.info.get("version", self.td3.updates))

    def _take_from_journal(self, blob: bytes) -> Optional[Trajectory]:
        """Takes a trajectory of the journal. None: it is refused, and counted.

        An earlier version of this program may have taken it; then the checkpoint counts its rows.
        """
        trajectory = None
        try:
            trajectory = Trajectory.unpack(blob)
            self.replay.add(trajectory)
            return trajectory
        except TrajectoryError as error:
            self.refused.add(str(error))
        if trajectory is not None and trajectory.fits(self.layout):
            self.replay.leave_out(len(trajectory))
        return None

    def _check_age(self, trajectory: Trajectory) -> None:
        version = trajectory.info.get("version", 0)
        if type(version) is not int:
            raise TrajectoryError("policy version %.40r is no number" % (version,))
        age = self.td3.updates - version
        if 0 < self.config.max_staleness < age:
            raise TrajectoryError("its policy was more than %d updates old" % self.config.max_staleness)

    # -- learning ----------------------------------------------------------------------------------
    @property
    def transitions(self) -> int:
        """Transitions taken so far."""
        return self.replay.transitions

    @property
    def collected(self) -> int:
        """Of the transitions taken, those that were driven for this run: all but a dataset's."""
        return self.transitions - self.given

    @property
    def _counted(self) -> int:
        """Transitions that gradient steps are due for, the warm-up beside them; a dataset does not shorten it."""
        return max(self.transitions, self.given + self.config.warmup)

    @property
    def updates_due(self) -> int:
        """Gradient steps not yet made for the transitions taken."""
        if not self.replay.held:
            return 0
        transitions, updates = self._pace
        due = int((self._counted - transitions) * self.config.updates_per_transition + 1e-9)
        return max(0, updates + due - self.td3.updates)

    def train(self, most: Optional[int] = None) -> int:
        """Make the gradient steps that are due, at most `most`; returns how many were made."""
        n = self.updates_due if most is None else min(self.updates_due, most)
        for _ in range(n):
            self.update()
        return n

    def update(self) -> None:
        """One gradient step on a batch drawn from the replay."""
        c = self.config.td3
        self.td3.update(
            draw_batch(self.replay, self.rng, c.batch_size, c.n_step, c.gamma, self.td3.device, self.config.mirror)
        )

    # -- checkpoints -------------------------------------------------------------------------------
    def save(self, extra: Optional[Dict[str, Any]] = None) -> None:
        """A checkpoint, whole or not at all: checkpoint.json, renamed into place last, names all the rest.

        Does nothing for a learner without a folder.
        """
        if self.folder is None or self.journal is None:
            return
        arrays, header = self.td3.state()
        self.journal.sync()
        data = safetensors.numpy.save(arrays, metadata=header)
        number = self.checkpoints + 1
        name = "learner-%06d.safetensors" % number
        write_bytes(self.folder / name, data)
        write_json(
            self.folder / "checkpoint.json",
            {
                "format": FORMAT,
                "number": number,
                "learner": {"file": name, "sha256": sha256(data)},
                "journal": self.journal.place,
                "layout": asdict(self.layout),
                "config": _plain(self.config),
                "rng": self.rng.bit_generator.state,
                "transitions": self.transitions,
                "given": self.given,
                "rows": self.replay.written,
                "episodes": self.episodes,
                "updates": self.td3.updates,
                "pace": list(self._pace),
                "seen": self.replay.episode_numbers(),
                "extra": extra or {},
            },
        )
        self.checkpoints = number
        self.journal.forget_before(self.replay.written - self.replay.capacity)
        for old in self.folder.glob("learner-*.safetensors"):
            if old.name != name:
                old.unlink(missing_ok=True)

    @staticmethod
    def saved(folder: os.PathLike | str) -> Optional[Dict[str, Any]]:
        """The checkpoint.json of a run folder, or None."""
        path = Path(folder) / "checkpoint.json"
        if not path.exists():
            return None
        checkpoint = read_json(path)
        if not isinstance(checkpoint, dict) or checkpoint.get("format") != FORMAT:
            raise StorageError("%s: not a checkpoint of this program" % path)
        return checkpoint

    @staticmethod
    def collected_in(checkpoint: Dict[str, Any]) -> int:
        """Of a checkpoint's transitions, those that were driven for the run; older runs counted all alike."""
        return checkpoint["transitions"] - checkpoint.get("given", 0)

    def resume(self, on_trajectory=lambda learner, trajectory: None, offline: bool = False) -> Dict[str, Any]:
        """Back to the last checkpoint, and on through what the journal holds behind it. Returns the checkpoint's extra.

        Gradient steps that are due for the last episode are left to train(). A folder without a checkpoint but with a
        journal is gone through from its beginning. A learner without a folder has nothing to go back to.

        Args:
            on_trajectory: called for every episode behind the checkpoint, on_trajectory(learner, trajectory).
            offline: make no gradient steps: those of offline learning are not due for transitions.
        """
        if self.folder is None or self.journal is None:
            return {}
        checkpoint = self.saved(self.folder)
        place, extra = None, {}
        if checkpoint is not None:
            place, extra = checkpoint["journal"], checkpoint["extra"]
            self._restore(checkpoint)
        learns = not offline
        for blob in self.journal.read(since=place):
            if learns:  # what was due had been made before this episode came
                self.train()
            trajectory = self._take_from_journal(blob)
            if trajectory is not None:
                self._count(trajectory)
                on_trajectory(self, trajectory)
                learns = not offline and trajectory.info["actor"] != DATASET  # which is taken whole before it is learnt
        return extra

    def _begin_with(self, folder: Path) -> None:
        """Takes over networks and optimisers of another run, and counts updates from 0. Raises as _take_networks()."""
        checkpoint = self.saved(folder)
        if checkpoint is None:
            raise LearnerError("%s holds no checkpoint: give the folder of a training run" % folder)
        theirs, own = checkpoint["config"]["td3"], _plain(self.config)["td3"]
        for name in ("layer_norm", "bins", *("value_low", "value_high") * bool(self.config.td3.bins)):
            if theirs.get(name, own[name]) != own[name]:  # the same weights would mean other values
                raise LearnerError(
                    "%s: its critics were trained with %s %s, this run has %s; give the same --%s"
                    % (folder, name, theirs[name], own[name], name.replace("_", "-"))
                )
        self._take_networks(folder, checkpoint)
        self.td3.updates = 0

    def _take_networks(self, folder: Path, checkpoint: Dict[str, Any]) -> None:
        """Takes over networks and optimisers from a checkpoint that lies in `folder`.

        Raises LearnerError where it is of other networks, StorageError where it is damaged.
        """
        if checkpoint["layout"] != asdict(self.layout):
            raise LearnerError(
                "%s was made with the layout %s, this run has %s" % (folder, checkpoint["layout"], asdict(self.layout))
            )
        path = folder / checkpoint["learner"]["file"]
        data = read_bytes(path)
        if sha256(data) != checkpoint["learner"]["sha256"]:
            raise StorageError("%s: its checksum is wrong; the file is damaged" % path)
        arrays, header = unpack(data, str(path), LearnerError)
        self.td3.load(arrays, header, what=str(folder))

    def _restore(self, checkpoint: Dict[str, Any]) -> None:
        assert self.folder is not None
        assert self.journal is not None
        self._take_networks(self.folder, checkpoint)
        first = self.journal.header()
        if first is not None:
            self.replay.begin_at(first["rows"], first["transitions"])
            self.episodes = first["episodes"]
        for blob in self.journal.read(until=checkpoint["journal"]):
            self._take_from_journal(blob)
        self.replay.restore_episode_numbers(checkpoint["seen"])
        if (self.replay.written, self.replay.transitions) != (checkpoint["rows"], checkpoint["transitions"]):
            raise StorageError(
                "%s: the journal holds %d transitions, the checkpoint counts %d; files are missing or damaged"
                % (self.folder, self.replay.transitions, checkpoint["transitions"])
            )
        self.rng.bit_generator.state = checkpoint["rng"]
        self.episodes, self.checkpoints = checkpoint["episodes"], checkpoint["number"]
        self.given = checkpoint.get("given", 0)  # older runs counted all alike
        self._resume_pace(checkpoint)

    def _resume_pace(self, checkpoint: Dict[str, Any]) -> None:
        """Goes on counting updates as before; another updates_per_transition or warmup counts from here on.

        Otherwise a smaller ratio would stop learning until the transitions have caught up with the updates that were
        made, and a larger one would begin with a burst of updates on old experience.
        """
        stored, config = checkpoint["config"], self.config
        transitions, updates = checkpoint.get("pace", (stored["warmup"], 0))
        same = (stored["updates_per_transition"], stored["warmup"]) == (config.updates_per_transition, config.warmup)
        if not same:
            transitions, updates = self._counted, self.td3.updates
        self._pace = (transitions, updates)


class Staleness:
    """How old, in updates, the policies were whose trajectories came in."""

    def __init__(self):
        self.count, self.total, self.most = 0, 0, 0

    def add(self, updates: int) -> None:
        """One more trajectory, of a policy so many updates old."""
        self.count, self.total, self.most = self.count + 1, self.total + updates, max(self.most, updates)

    @property
    def mean(self) -> float:
        """Mean age in updates; 0 before the first trajectory."""
        return self.total / self.count if self.count else 0.0


def _plain(config) -> Dict[str, Any]:
    return json.loads(json.dumps(asdict(config)))
