"""Learner: adds trajectories to the replay buffer and makes the gradient steps that are due.

./applr train runs one learner. A killed run continues from its last checkpoint.
"""

from __future__ import annotations

import io
import os
from collections import deque
from pathlib import Path
from typing import Any, Deque, Dict, List, Optional

import numpy as np
import safetensors.numpy
import torch

from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import read_bytes, read_json, reading, write_bytes, write_json
from applr_ros1.common.tensors import unpack
from applr_ros1.policy.actor import load
from applr_ros1.robots import JACKAL, Robot
from training.common.folders import make_folder
from training.env.trajectory import Trajectory, TransitionLayout
from training.train.learner.config import LearnerOptions
from training.train.replay.buffer import ReplayBuffer
from training.train.replay.dataset import Dataset
from training.train.td3.td3 import TD3, ActorWeights, Batch

CHECKPOINT = "checkpoint.json"  # name of the file that names all other files of a checkpoint


class Learner:
    """Networks, replay buffer and their checkpoints.

    A learner continues from the last checkpoint in its folder.

    Args:
        layout: Layout of observations and actions.
        options: Options of learning.
        folder: Folder of the run with checkpoint.json, learner-*.pt and replay-*.safetensors.
        rows: Capacity of the replay buffer.
        init_from: Run folder or policy file whose networks are taken over, unless `folder` has a
            checkpoint or there is an `action`.
        robot: Robot that a policy file must fit.
        action: Action (m,) in [-1, 1] that the untrained policy returns for every observation, or
            None.
        dataset: Experience of an offline run. It makes no gradient steps due.

    Attributes:
        extra: Values that save() stored in the checkpoint.

    Raises:
        ApplrError: The networks in `folder` or `init_from` do not fit `layout` and `options`, or
            `init_from` has none.
    """

    def __init__(
        self,
        layout: TransitionLayout,
        options: LearnerOptions,
        folder: os.PathLike[str] | str,
        rows: int,
        init_from: str = "",
        robot: Robot = JACKAL,
        action: Optional[Array] = None,
        dataset: Optional[Dataset] = None,
    ):
        self.layout = layout
        self.options = options
        self.folder = make_folder(folder)
        self.td3 = TD3(
            layout.size,
            layout.action,
            options,
            seed=options.seed,
            device="cuda" if torch.cuda.is_available() else "cpu",
            mirror=layout.policy_mirror,
            hidden=layout.hidden,
        )
        self.replay = ReplayBuffer(layout, rows)
        if dataset is not None:
            for trajectory in dataset.trajectories():
                self.replay.add(trajectory)
        # Not the seed alone, which gives the networks' weights
        self.rng = np.random.default_rng([options.seed, 1])
        self.infos: Deque[Dict[str, Any]] = deque(maxlen=100)  # info of the latest trajectories
        self.checkpoints = 0
        self.extra: Dict[str, Any] = {}
        self._kept: List[List[Any]] = []  # files of the replay buffer and their numbers of rows
        self._due = 0.0  # number of gradient steps still due for the transitions
        # A checkpoint of this run counts more than any other start.
        if checkpoint := self.saved(folder):
            with reading(self.folder / CHECKPOINT):
                self._restore(checkpoint)
        elif action is not None:
            self.td3.begin_at(action)
        elif init_from.endswith(".safetensors"):
            with reading(init_from):
                self.td3.begin_with(policy_network(init_from, robot))
        elif init_from:
            self._begin_with(Path(init_from))
        # Value of replay.written up to which rows are saved in files
        self._saved = self.replay.written

    # -- taking ------------------------------------------------------------------------------------
    def add_trajectory(self, trajectory: Trajectory) -> None:
        """Add an actor's trajectory.

        Transitions after learning_starts make gradient steps due.
        """
        counted = max(self.transitions, self.options.learning_starts)
        self.replay.add(trajectory)
        self._due += self.options.utd_ratio * max(0, self.transitions - counted)
        self.infos.append(trajectory.info)

    # -- learning ----------------------------------------------------------------------------------
    @property
    def transitions(self) -> int:
        """Number of transitions so far."""
        return self.replay.transitions

    @property
    def updates_due(self) -> int:
        """Number of gradient steps that are due for the transitions so far."""
        return int(self._due + 1e-6)  # Ten times .1 is less than 1.

    def update(self) -> None:
        """Make one gradient step on a batch from the replay buffer."""
        self._due -= 1.0
        self.td3.update(draw_batch(self.replay, self.rng, self.options, self.td3.device))

    # -- checkpoints -------------------------------------------------------------------------------
    def save(self, extra: Optional[Dict[str, Any]] = None) -> None:
        """Save a checkpoint atomically: checkpoint.json is written last and names all other files.

        New rows of the replay buffer go to a new file. A file is deleted once the ring has
        overwritten its rows.
        """
        # Networks and optimisers
        checkpoint_number = self.checkpoints + 1
        state_buffer = io.BytesIO()
        torch.save(self.td3.state(), state_buffer)
        learner_file = f"learner-{checkpoint_number:06d}.pt"
        write_bytes(self.folder / learner_file, state_buffer.getvalue())

        # New rows of the replay buffer
        written = self.replay.written
        if written > self._saved:
            replay_file = f"replay-{checkpoint_number:06d}.safetensors"
            rows = self.replay.rows(self._saved)
            write_bytes(self.folder / replay_file, safetensors.numpy.save(rows))
            self._kept.append([replay_file, written - self._saved])
            self._saved = written
        # The other files fill the ring: nothing of the oldest one is left in it.
        while sum(count for _, count in self._kept[1:]) >= self.replay.capacity:
            self._kept.pop(0)
        write_json(
            self.folder / CHECKPOINT,
            {
                "number": checkpoint_number,
                "learner": learner_file,
                "replay": self._kept,
                "layer_norm": self.options.layer_norm,
                "rng": self.rng.bit_generator.state,
                "transitions": self.transitions,
                "updates": self.td3.updates,
                "extra": extra or {},
            },
        )
        self.checkpoints = checkpoint_number

        # Only now, because the checkpoint before this one needs its own files.
        needed = {learner_file}
        for kept_file, _ in self._kept:
            needed.add(kept_file)
        for pattern in ("learner-*.pt", "replay-*.safetensors"):
            for existing_file in self.folder.glob(pattern):
                if existing_file.name not in needed:
                    existing_file.unlink(missing_ok=True)

    @staticmethod
    def saved(folder: os.PathLike[str] | str) -> Optional[Dict[str, Any]]:
        """Return the content of checkpoint.json in a run folder, or None without this file."""
        checkpoint_file = Path(folder) / CHECKPOINT
        return read_json(checkpoint_file) if checkpoint_file.exists() else None

    def _restore(self, checkpoint: Dict[str, Any]) -> None:
        """Continue from a checkpoint of this run."""
        self._take_networks(self.folder, checkpoint)
        for file_name, _ in checkpoint["replay"]:
            replay_file = self.folder / file_name
            with reading(replay_file):
                rows, _ = unpack(read_bytes(replay_file), str(replay_file))
                self.replay.restore_rows(rows)
        self.replay.transitions = checkpoint["transitions"]
        self.rng.bit_generator.state = checkpoint["rng"]
        self._kept = checkpoint["replay"]
        self.checkpoints = checkpoint["number"]
        self.extra = checkpoint["extra"]

    def _begin_with(self, folder: Path) -> None:
        """Take over networks and optimisers of another run, and reset the number of updates."""
        checkpoint = self.saved(folder)
        if checkpoint is None:
            raise ApplrError(
                f"--init-from is {str(folder)!r}: give static, dwa, a JSON file with a parameter "
                "set, the file of a policy, or the folder of a training run that has saved a "
                "checkpoint"
            )
        with reading(folder / CHECKPOINT):
            # With another layer_norm, the same weights give other values.
            if checkpoint["layer_norm"] != self.options.layer_norm:
                other_layer_norm = checkpoint["layer_norm"]
                raise ApplrError(
                    f"its critics have layer_norm {other_layer_norm}: choose the same value"
                )
            self._take_networks(folder, checkpoint)
        self.td3.updates = 0
        self.td3.policy_starts = 0  # The critics have learned already.

    def _take_networks(self, folder: Path, checkpoint: Dict[str, Any]) -> None:
        """Load networks and optimisers of a checkpoint in `folder`."""
        state_file = folder / checkpoint["learner"]
        with reading(state_file):
            state_buffer = io.BytesIO(read_bytes(state_file))
            self.td3.load(torch.load(state_buffer, self.td3.device, weights_only=True))


def policy_network(path: str, robot: Robot) -> ActorWeights:
    """Return the first network of a policy file; the second may be its mirror image.

    Raises:
        ApplrError: The file is not a policy, or one for another robot.
    """
    weights = {}
    for layer, (weight, bias) in enumerate(load(path, robot).layers):
        if weight.ndim == 3:  # (networks, out, in)
            weight = weight[0]
            bias = bias[0]
        weights[f"{layer}.weight"] = weight
        weights[f"{layer}.bias"] = bias
    return weights


def draw_batch(
    replay: ReplayBuffer, rng: np.random.Generator, options: LearnerOptions, device: torch.device
) -> Batch:
    """Return a uniformly drawn batch for TD3.update.

    With options.mirror, half of it is mirrored. All randomness of a gradient step comes from `rng`:
    first the rows, then the smoothing noise.
    """
    size = options.batch_size
    rows = replay.draw(rng, size)
    following, discount = replay.following(rows, options.gamma)
    noise = rng.standard_normal((size, replay.layout.action), dtype=np.float32)

    def tensor(array: np.ndarray) -> torch.Tensor:
        # Bytes become floats on the device, because four times as many would have to go there.
        return torch.from_numpy(array).to(device).to(torch.float32)

    def observation(places: np.ndarray) -> torch.Tensor:
        mirrored = size // 2 if options.mirror else 0
        scan, other_entries = replay.observations(places, mirrored)
        beams = tensor(scan).mul_(replay.layout.step).sub_(1.0)
        return torch.cat((beams, tensor(other_entries)), 1)

    return Batch(
        observation=observation(rows),
        action=tensor(replay.action[rows]),
        reward=tensor(replay.reward[rows]),
        discount=tensor(discount),
        next_observation=observation(following),
        noise=tensor(noise),
    )
