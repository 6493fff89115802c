"""Recorded experience for offline training: npz shards, a JSON manifest, checksums.

bags_to_dataset makes it from bags, python -m training.dataset from a training run; train.py --dataset reads it. Shards
hold plain arrays: nothing is pickled.

manifest.json: {"format", "layout": {scan, rest, action}, "scan_step", "source", "transitions", "skipped",
"shards": [{file, sha256, episodes, transitions}]}. source says where the experience comes from, and by period, weights,
robot and reward (the coefficients) what it was driven with, where these are known. A shard: scan (rows, 720) uint8 and
rest (rows, 9) of its episodes one after the other, T + 1 rows each; action (sum T, 8), reward (sum T,), length
(episodes,) of T, terminated (episodes,), info: JSON of the episodes' infos as bytes.
"""

from __future__ import annotations

import io
import json
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, Dict, Iterator, List, Optional

import numpy as np

from applr_ros1.common.arrays import unpack_npz
from applr_ros1.common.errors import ApplrError, reason
from applr_ros1.common.files import StorageError, read_bytes, read_json, sha256, write_bytes, write_json
from applr_ros1.common.tally import Tally
from training.experience.journal import Journal
from training.experience.trajectory import MAX_TRANSITIONS, Layout, Trajectory, TrajectoryError
from training.storage import make_folder

FORMAT = "applr-dataset-1"
SHARD_ROWS = 20_000
MAX_SHARD = 2**30  # bytes of a shard, unpacked
SHARD_ARRAYS = {"scan": 2, "rest": 2, "action": 2, "reward": 1, "length": 1, "terminated": 1, "info": 1}  # ndim


class DatasetError(ApplrError):
    """A dataset that cannot be used; one line with which file and why."""


class Writer:
    """add() trajectories, then close(): the manifest, written last, makes the dataset valid."""

    def __init__(self, folder, layout: Layout = Layout(), source: Optional[Dict[str, Any]] = None):
        self.folder, self.layout, self.source = make_folder(folder), layout, source or {}
        if (self.folder / "manifest.json").exists():
            raise StorageError("%s: holds a dataset already; give an empty folder" % folder)
        self.skipped = Tally()  # episodes, by reason
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
        self.skipped.add(reason)

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
    """A dataset to read, of a layout; None: the one that it states.

    Raises:
        DatasetError: it is none, or of another layout.
    """

    def __init__(self, folder, layout: Optional[Layout] = Layout()):
        self.folder = Path(folder)
        if not (self.folder / "manifest.json").exists():
            raise DatasetError("%s: no dataset (no manifest.json); make one with bags_to_dataset.py" % folder)
        self.manifest = read_json(self.folder / "manifest.json")
        if not isinstance(self.manifest, dict) or self.manifest.get("format") != FORMAT:
            raise DatasetError("%s: manifest.json is not of format %s" % (folder, FORMAT))
        layout = layout or self._stated_layout()
        self.layout = layout
        if self.manifest.get("layout") != asdict(layout):
            raise DatasetError(
                "%s: its layout is %s, this training has %s" % (folder, self.manifest.get("layout"), asdict(layout))
            )
        shards = self.manifest.get("shards")
        if not isinstance(shards, list) or not all(map(_is_shard, shards)):
            raise DatasetError("%s: manifest.json: shards must be a list of {%s}" % (folder, ", ".join(SHARD_KEYS)))
        if self.manifest.get("transitions") != sum(s["transitions"] for s in shards):
            raise DatasetError(
                "%s: manifest.json counts %.40r transitions, its shards do not"
                % (folder, self.manifest.get("transitions"))
            )

    def _stated_layout(self) -> Layout:
        stated = self.manifest.get("layout")
        names = [field.name for field in fields(Layout)]
        if not (isinstance(stated, dict) and sorted(stated) == sorted(names)):
            raise DatasetError("%s: states no layout; it needs the numbers %s" % (self.folder, ", ".join(names)))
        if not all(type(stated[name]) is int and stated[name] >= 0 for name in names):
            raise DatasetError("%s: its layout is %.80r; give whole numbers from 0" % (self.folder, stated))
        return Layout(**stated)

    @property
    def transitions(self) -> int:
        """Number of transitions."""
        return int(self.manifest["transitions"])

    @property
    def digest(self) -> str:
        """SHA-256 of the checksums of its shards: another one means other experience."""
        return sha256("".join(shard["sha256"] for shard in self.manifest["shards"]).encode())

    @property
    def source(self) -> Dict[str, Any]:
        """Where the experience comes from, and as far as known its period, weights and robot."""
        source = self.manifest.get("source")
        return source if isinstance(source, dict) else {}

    @property
    def rows(self) -> int:
        """Number of observations: one more than transitions for each episode."""
        return sum(s["transitions"] + s["episodes"] for s in self.manifest["shards"])

    def __iter__(self) -> Iterator[Trajectory]:
        """Every episode, checked. Raises DatasetError at the first that is not right, naming its file."""
        for shard in self.manifest["shards"]:
            yield from self._read(shard)

    def check(self) -> "Dataset":
        """Reads all of it; returns itself. Raises DatasetError at the first fault, and where there is no transition."""
        if not sum(len(trajectory) for trajectory in self):
            raise DatasetError("%s: holds no transitions" % self.folder)
        return self

    def _read(self, shard: Dict[str, Any]) -> Iterator[Trajectory]:
        name = shard["file"]
        if Path(name).name != name:
            raise DatasetError("%s: shard %r lies outside the dataset's folder" % (self.folder, name))
        path = self.folder / name
        data = read_bytes(path, MAX_SHARD, DatasetError)
        if sha256(data) != shard["sha256"]:
            raise DatasetError("%s: checksum is wrong; the file is damaged or was changed" % path)
        arrays = unpack_npz(data, str(path), MAX_SHARD, DatasetError)
        infos = _infos(arrays, shard, path)
        row = step = 0
        for i, t in enumerate(arrays["length"].tolist()):
            trajectory = Trajectory(
                arrays["scan"][row : row + t + 1],
                arrays["rest"][row : row + t + 1],
                arrays["action"][step : step + t],
                arrays["reward"][step : step + t],
                bool(arrays["terminated"][i]),
                infos[i],
            )
            try:
                trajectory.check(self.layout)
            except TrajectoryError as error:
                raise DatasetError("%s: episode %d: %s" % (path, i, error)) from None
            row, step = row + t + 1, step + t
            yield trajectory


SHARD_KEYS = {"file": str, "sha256": str, "episodes": int, "transitions": int}


def _is_shard(value: Any) -> bool:
    return isinstance(value, dict) and all(
        type(value.get(key)) is kind and (kind is str or value[key] >= 0) for key, kind in SHARD_KEYS.items()
    )


def _infos(arrays: Dict[str, np.ndarray], shard: Dict[str, Any], path: Path) -> List[Dict[str, Any]]:
    """The episodes' infos, once the shard's arrays are known to be there and to agree. Raises DatasetError."""
    for name, ndim in SHARD_ARRAYS.items():
        if name not in arrays or arrays[name].ndim != ndim:
            raise DatasetError("%s: not a shard of a dataset (no array %s of %d dimensions)" % (path, name, ndim))
    lengths = arrays["length"]
    try:
        infos = json.loads(arrays["info"].tobytes())
    except (ValueError, RecursionError) as error:
        raise DatasetError("%s: not a shard of a dataset (info: %s)" % (path, reason(error))) from None
    if not isinstance(infos, list) or not all(isinstance(info, dict) for info in infos):
        raise DatasetError("%s: not a shard of a dataset (info must be a list of objects)" % path)
    if lengths.dtype.kind not in "iu" or (lengths < 1).any() or (lengths > MAX_TRANSITIONS).any():
        raise DatasetError("%s: lengths of episodes must be whole numbers from 1 to %d" % (path, MAX_TRANSITIONS))
    episodes, transitions = len(lengths), int(lengths.sum())
    counts = {
        "info": (len(infos), episodes),
        "terminated": (len(arrays["terminated"]), episodes),
        "episodes in manifest.json": (shard["episodes"], episodes),
        "action": (len(arrays["action"]), transitions),
        "reward": (len(arrays["reward"]), transitions),
        "transitions in manifest.json": (shard["transitions"], transitions),
        "scan": (len(arrays["scan"]), transitions + episodes),
        "rest": (len(arrays["rest"]), transitions + episodes),
    }
    for name, (found, wanted) in counts.items():
        if found != wanted:
            raise DatasetError("%s: %s: %d where %d are needed" % (path, name, found, wanted))
    return infos


def export_replay(
    run, folder, layout: Optional[Layout] = None, c_switch: float = 0.0, driven: Optional[Dict[str, Any]] = None
) -> Dict[str, Any]:
    """Write the journal of a training run as a dataset; returns the manifest.

    Each episode holds its own changes of the parameters, so that their price can be set afterwards.

    Args:
        run: folder of the run.
        folder: of the dataset.
        layout: what observations and actions consist of; None: as in the first episode.
        c_switch: added to the price of such changes that the run had (reward per unit of mean change, in units of the
            action).
        driven: for the manifest's source: the run's period, weights, robot and reward; c_switch is added to the latter.

    Raises:
        DatasetError, StorageError, TrajectoryError: with one line.
    """
    if not (Path(run) / "journal").is_dir():
        raise DatasetError("%s: no training run (no journal in it)" % run)
    journal = Journal(Path(run) / "journal")
    if layout is None:
        first = next(journal.read(), None)
        if first is None:
            raise DatasetError("%s: no episode is in its journal; train first" % run)
        layout = Trajectory.unpack(first).layout
    source: Dict[str, Any] = {"run": Path(run).name, "c_switch": c_switch, **(driven or {})}
    if "reward" in source:
        source["reward"] = dict(source["reward"], c_switch=source["reward"].get("c_switch", 0.0) + c_switch)
    writer = Writer(folder, layout, source)
    for blob in journal.read():
        trajectory = Trajectory.unpack(blob)
        if c_switch:
            trajectory.check(layout)
            before = trajectory.rest[:-1, -layout.action :]
            trajectory.reward = trajectory.reward - np.float32(c_switch) * np.abs(trajectory.action - before).mean(1)
        writer.add(trajectory)
    return writer.close()
