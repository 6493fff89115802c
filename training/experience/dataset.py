"""Recorded experience for offline training: npz shards, a JSON manifest, checksums.

bags_to_dataset makes it from bags, python -m training.dataset from a training run; train.py --dataset reads it. Shards
hold plain arrays: nothing is pickled.

manifest.json: {"format", "layout": {scan, rest, action}, "scan_step", "source", "transitions", "skipped",
"shards": [{file, sha256, episodes, transitions}]}. A shard: scan (rows, 720) uint8 and rest (rows, 9) of its episodes
one after the other, T + 1 rows each; action (sum T, 8), reward (sum T,), length (episodes,) of T, terminated
(episodes,), info: JSON of the episodes' infos as bytes.
"""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import asdict
from pathlib import Path
from typing import Any, Dict, Iterator, List, Optional

import numpy as np

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import StorageError, read_bytes, read_json, sha256, write_bytes, write_json
from training.experience.journal import Journal
from training.experience.trajectory import Layout, Trajectory, TrajectoryError
from training.storage import make_folder

FORMAT = "applr-dataset-1"
SHARD_ROWS = 20_000


class DatasetError(ApplrError):
    """A dataset that cannot be used; one line with which file and why."""


class Writer:
    """add() trajectories, then close(): the manifest, written last, makes the dataset valid."""

    def __init__(self, folder, layout: Layout = Layout(), source: Optional[Dict[str, Any]] = None):
        self.folder, self.layout, self.source = make_folder(folder), layout, source or {}
        if (self.folder / "manifest.json").exists():
            raise StorageError("%s: holds a dataset already; give an empty folder" % folder)
        self.skipped: Dict[str, int] = {}  # reason → how many episodes
        self._shards: List[Dict[str, Any]] = []
        self._pending: List[Trajectory] = []

    def add(self, trajectory: Trajectory) -> None:
        """Raises TrajectoryError for one that is malformed."""
        trajectory.check(self.layout)
        self._pending.append(trajectory)
        if sum(len(t) + 1 for t in self._pending) >= SHARD_ROWS:
            self._flush()

    def skip(self, reason: str) -> None:
        """Count a transition that is not taken, by the reason."""
        self.skipped[reason] = self.skipped.get(reason, 0) + 1

    def close(self) -> Dict[str, Any]:
        """Writes what is pending and the manifest; returns it."""
        self._flush()
        manifest = {
            "format": FORMAT,
            "layout": asdict(self.layout),
            "scan_step": self.layout.step,
            "source": self.source,
            "skipped": self.skipped,
            "transitions": sum(s["transitions"] for s in self._shards),
            "shards": self._shards,
        }
        write_json(self.folder / "manifest.json", manifest)
        return manifest

    def _flush(self) -> None:
        if not self._pending:
            return
        episodes, self._pending = self._pending, []
        arrays = {
            name: np.concatenate([getattr(t, name) for t in episodes]) for name in ("scan", "rest", "action", "reward")
        }
        arrays["length"] = np.array([len(t) for t in episodes], np.int64)
        arrays["terminated"] = np.array([t.terminated for t in episodes], bool)
        arrays["info"] = np.frombuffer(json.dumps([t.info for t in episodes]).encode(), np.uint8)
        buffer = io.BytesIO()
        np.savez_compressed(buffer, allow_pickle=False, **arrays)
        name = "shard-%05d.npz" % len(self._shards)
        write_bytes(self.folder / name, buffer.getvalue())
        self._shards.append(
            {
                "file": name,
                "sha256": sha256(buffer.getvalue()),
                "episodes": len(episodes),
                "transitions": int(arrays["length"].sum()),
            }
        )


class Dataset:
    """A dataset to read. Raises DatasetError where it is none, or of another layout."""

    def __init__(self, folder, layout: Layout = Layout()):
        self.folder, self.layout = Path(folder), layout
        if not (self.folder / "manifest.json").is_file():
            raise DatasetError("%s: no dataset (no manifest.json); make one with bags_to_dataset.py" % folder)
        self.manifest = read_json(self.folder / "manifest.json")
        if not isinstance(self.manifest, dict) or self.manifest.get("format") != FORMAT:
            raise DatasetError("%s: manifest.json is not of format %s" % (folder, FORMAT))
        if self.manifest.get("layout") != asdict(layout):
            raise DatasetError(
                "%s: its layout is %s, this training has %s" % (folder, self.manifest.get("layout"), asdict(layout))
            )

    @property
    def transitions(self) -> int:
        """Number of transitions."""
        return int(self.manifest["transitions"])

    @property
    def rows(self) -> int:
        """Number of observations: one more than transitions for each episode."""
        return sum(s["transitions"] + s["episodes"] for s in self.manifest["shards"])

    def __iter__(self) -> Iterator[Trajectory]:
        """Every episode, checked. Raises DatasetError at the first that is not right, naming its file."""
        for shard in self.manifest["shards"]:
            yield from self._read(shard)

    def _read(self, shard) -> Iterator[Trajectory]:
        name = str(shard["file"])
        if Path(name).name != name:
            raise DatasetError("%s: shard %r lies outside the dataset's folder" % (self.folder, name))
        path = self.folder / name
        data = read_bytes(path)
        if sha256(data) != shard["sha256"]:
            raise DatasetError("%s: checksum is wrong; the file is damaged or was changed" % path)
        try:
            with np.load(io.BytesIO(data), allow_pickle=False) as file:
                arrays = {key: file[key] for key in file.files}
            infos = json.loads(arrays["info"].tobytes())
            lengths, terminated = arrays["length"], arrays["terminated"]
            if not len(infos) == len(lengths) == len(terminated):
                raise ValueError("numbers of episodes differ")
        except (ValueError, KeyError, OSError, zipfile.BadZipFile, RecursionError) as error:
            raise DatasetError("%s: not a shard of a dataset (%s)" % (path, error)) from None
        row = step = 0
        for i, t in enumerate(int(n) for n in lengths):
            trajectory = Trajectory(
                arrays["scan"][row : row + t + 1],
                arrays["rest"][row : row + t + 1],
                arrays["action"][step : step + t],
                arrays["reward"][step : step + t],
                bool(terminated[i]),
                infos[i],
            )
            try:
                trajectory.check(self.layout)
            except (TrajectoryError, AttributeError) as error:
                raise DatasetError("%s: episode %d: %s" % (path, i, error)) from None
            row, step = row + t + 1, step + t
            yield trajectory


def export_replay(run, folder, layout: Layout = Layout(), c_switch: float = 0.0) -> Dict[str, Any]:
    """Write the journal of a training run as a dataset; returns the manifest.

    Each episode holds its own changes of the parameters, so that their price can be set afterwards: `c_switch` is added
    to the price that the run had (reward per unit of mean change, in units of the action).
    """
    if not (Path(run) / "journal").is_dir():
        raise DatasetError("%s: no training run (no journal in it)" % run)
    writer = Writer(folder, layout, {"run": Path(run).name, "c_switch": c_switch})
    for blob in Journal(Path(run) / "journal").read():
        trajectory = Trajectory.unpack(blob)
        if c_switch:
            before = trajectory.rest[:-1, -layout.action :]
            trajectory.reward = trajectory.reward - np.float32(c_switch) * np.abs(trajectory.action - before).mean(1)
        writer.add(trajectory)
    return writer.close()
