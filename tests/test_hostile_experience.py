"""What hostile or damaged experience does: answers of actors, journals, datasets and bags. One line, bounded memory."""

import bz2
import hashlib
import io
import json
import os
import signal
import struct
import subprocess
import sys
import tracemalloc
import zipfile
from pathlib import Path

import lz4.frame
import numpy as np
import pytest

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.tally import MOST, OTHERS, Tally
from training import appld, bags_to_dataset, compare_gazebo, demonstrate, static_search
from training import dataset as export
from training.bags import compression, reader
from training.baselines.appld import demonstration
from training.baselines.appld.scripted_driver import Demonstrator
from training.experience.dataset import Dataset, DatasetError, Writer
from training.experience.trajectory import Layout, Trajectory
from training.gorila.curves import EpisodeLog
from training.gorila.learner import Learner, LearnerConfig
from training.td3.td3 import TD3Config
from training.train import main

LAYOUT = Layout(0, 1, 1)
CONFIG = LearnerConfig(TD3Config(hidden=(8,), batch_size=8), 1000, 1.0)


def episode(number, transitions=10, **info):
    rng = np.random.default_rng(number)
    return Trajectory.of(
        LAYOUT,
        rng.uniform(-1, 1, (transitions + 1, 1)),
        rng.uniform(-1, 1, (transitions, 1)),
        rng.normal(size=transitions),
        False,
        dict({"actor": "a", "episode": number, "version": 0}, **info),
    )


WRONG = [
    {"return": [1.0]},
    {"success": "yes"},
    {"time_s": {}},
    {"world": "two\nlines"},
    {"world": "lone \ud800 surrogate"},
    {"world": ["a"]},
    {"length": 10**400},
    {"episode": 10**400},
    {"actor": "a\nb"},
]


@pytest.mark.parametrize("info", WRONG, ids=lambda info: next(iter(info)))
def test_an_answer_with_a_malformed_info_is_refused_and_counted(info, tmp_path):
    learner = Learner(LAYOUT, CONFIG, tmp_path)
    assert learner.take(episode(0).pack()) is not None
    assert learner.take(episode(1, **info).pack()) is None
    assert sum(learner.refused.values()) == 1
    assert len(list(learner.journal.read())) == 1


@pytest.mark.parametrize("checkpoint_after", [0, 1, 2, 3])
def test_a_journal_that_holds_a_malformed_record_resumes_without_it(tmp_path, checkpoint_after, monkeypatch):
    """The record lies before or behind the checkpoint, in a folder that a version without the check has written."""
    with monkeypatch.context() as older:
        older.setattr(Trajectory, "check_info", lambda self: None)
        learner = Learner(LAYOUT, CONFIG, tmp_path)
        for number, info in enumerate(({}, {"world": "two\nlines", "return": "x"}, {})):
            if number == checkpoint_after:
                learner.save()
            learner.take(episode(number, **info).pack())
            learner.train()
        if checkpoint_after == 3:
            learner.save()
    rows = learner.replay.written
    for _ in range(2):  # the second time from a checkpoint that was made after the record was refused
        heard = []
        learner = Learner(LAYOUT, CONFIG, tmp_path)
        learner.resume(lambda _, trajectory, heard=heard: heard.append(trajectory.info["episode"]))
        assert heard == [n for n in range(checkpoint_after, 3) if n != 1]
        assert list(learner.refused.values()) == [1]
        assert (learner.replay.written, learner.replay.held) == (rows, 20)
        checkpoint_after = 3
        learner.save()


def test_refused_texts_do_not_grow_without_end():
    tally = Tally()
    for number in range(1000):
        tally.add("reason %d" % number)
    assert len(tally) == MOST + 1
    assert sum(tally.values()) == 1000
    assert tally[OTHERS] == 1000 - MOST


def test_a_table_of_episodes_with_a_broken_row_is_read_without_it(tmp_path):
    log = EpisodeLog(tmp_path, 0)
    for transitions in (10, 20, 30, 40):
        log.add(transitions, {"return": 1.0, "length": 10, "success": True, "world": "w", "version": 0})
    log.close()
    broken = log.path.read_text().replace("20,1,10,1,,,w,,0", "20,1,10,1,,,two\nlines,,0")
    assert broken != log.path.read_text()
    log.path.write_text(broken)
    again = EpisodeLog(tmp_path, 30)  # a run that is resumed from a checkpoint at 30 transitions
    assert [row[0] for row in again.rows] == [10, 30]
    assert again.path.read_text().count("\n") == 3
    again.close()


@pytest.mark.parametrize(
    "content",
    [
        {"log": []},
        {"log": {}},
        {"theta": 1},
        {"theta": [1.0] * 8},
        {"theta": {"max_vel_x": float("nan")}},
        [1],
        {"max_vel_x": "fast"},
    ],
)
def test_a_search_does_not_start_from_a_malformed_file(content, tmp_path, capsys):
    start = tmp_path / "start.json"
    start.write_text(json.dumps(content))
    command = ["--worlds", "generated:0", "--workers", "0", "--start", str(start), "--out", str(tmp_path / "s.json")]
    assert static_search.main(command) == 1
    error = capsys.readouterr().err.strip()
    assert error.startswith("static_search.py: ")
    assert "\n" not in error
    assert str(start) in error


@pytest.mark.parametrize(
    ("command", "arguments", "word"),
    [
        (appld, ["x.bag", "--out", "x.safetensors", "--seed", "-1"], "--seed"),
        (appld, ["x.bag", "--out", "x.safetensors", "--steps", "many"], "--steps"),
        (bags_to_dataset, ["x.bag"], "--out"),
        (compare_gazebo, [], "trials"),
        (export, ["run", "folder", "--c-switch", "much"], "--c-switch"),
        (demonstrate, ["x.bag", "--seed", "-1"], "--seed"),
        (static_search, ["--seed", "-1"], "--seed"),
        (static_search, ["--population", "3"], "--population"),
    ],
)
def test_mistakes_on_the_other_command_lines_are_one_line(command, arguments, word, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert command.main(arguments) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert word in error
    assert not list(tmp_path.iterdir())


# -- datasets ----------------------------------------------------------------------------------------------------------
@pytest.fixture
def dataset(tmp_path):
    writer = Writer(tmp_path / "data", LAYOUT)
    for number in range(3):
        writer.add(episode(number, 4))
    writer.close()
    return tmp_path / "data"


def change_manifest(folder, change):
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text())
    change(manifest)
    path.write_text(json.dumps(manifest))


def change_shard(folder, data):
    """Other content of the shard, with its right checksum."""
    (folder / "shard-00000.npz").write_bytes(data)
    change_manifest(folder, lambda m: m["shards"][0].update(sha256=hashlib.sha256(data).hexdigest()))


def shard(folder, **changes):
    arrays = dict(np.load(folder / "shard-00000.npz"))
    arrays.update(changes)
    buffer = io.BytesIO()
    np.savez(buffer, **{name: value for name, value in arrays.items() if value is not None})
    return buffer.getvalue()


@pytest.mark.parametrize(
    "change",
    [
        lambda m: m.pop("shards"),
        lambda m: m.update(shards={}),
        lambda m: m.update(shards=[[]]),
        lambda m: m.update(transitions=None),
        lambda m: m.update(transitions=7),
        lambda m: m["shards"][0].pop("sha256"),
        lambda m: m["shards"][0].update(file=3),
        lambda m: m["shards"][0].update(file="../x.npz"),
        lambda m: m["shards"][0].update(episodes=2),
        lambda m: m["shards"][0].update(transitions=-1),
    ],
)
def test_manifests_with_wrong_or_missing_keys(dataset, change):
    change_manifest(dataset, change)
    with pytest.raises(DatasetError, match=str(dataset)) as refused:
        Dataset(dataset, LAYOUT).check()
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"scan": None}, "scan"),
        ({"length": np.array([4, np.nan, 4])}, "lengths"),
        ({"length": np.array([4, 8, 0])}, "lengths"),
        ({"length": np.array([4, 4])}, "needed"),
        ({"length": np.array(4)}, "length"),
        ({"info": np.frombuffer(b"[1, 2, 3]", np.uint8)}, "list of objects"),
        ({"info": np.frombuffer(b"{}", np.uint8)}, "list of objects"),
        ({"info": np.frombuffer(b"[" * 100_000, np.uint8)}, "info"),
        ({"reward": np.zeros((12, 1), np.float32)}, "reward"),
        ({"action": np.zeros((11, 1), np.float32)}, "action: 11 where 12"),
        ({"rest": np.zeros(0, np.float32)}, "rest"),
    ],
)
def test_shards_with_wrong_or_missing_arrays(dataset, change, why):
    change_shard(dataset, shard(dataset, **change))
    with pytest.raises(DatasetError, match=why) as refused:
        Dataset(dataset, LAYOUT).check()
    assert "\n" not in str(refused.value)


def test_shards_that_are_no_archives_or_unpack_to_too_much(dataset, tmp_path, monkeypatch):
    def archive(write, method=zipfile.ZIP_DEFLATED):
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w", method) as file:
            write(file)
        return buffer.getvalue()

    header = b"\x93NUMPY\x01\x00v\x00" + b"{'descr': '<f8', 'fortran_order': False, 'shape': (%d,), }"
    header = (header % 10**15).ljust(127) + b"\n"
    bombs = {
        "empty": b"",
        "text": b"not an archive",
        "claims a petabyte": archive(lambda file: file.writestr("scan.npy", header)),
        "unpacks to 3 MiB": archive(lambda file: file.writestr("scan.npy", bytes(3 << 20))),
        "bz2": archive(lambda file: file.writestr("scan.npy", bytes(100)), zipfile.ZIP_BZIP2),
    }
    monkeypatch.setattr("training.experience.dataset.MAX_SHARD", 1 << 20)
    for name, data in bombs.items():
        change_shard(dataset, data)
        with pytest.raises(DatasetError) as refused:
            Dataset(dataset, LAYOUT).check()
        assert "\n" not in str(refused.value), name
    (dataset / "shard-00000.npz").unlink()
    os.mkfifo(dataset / "shard-00000.npz")
    with pytest.raises(DatasetError, match="pipe"):
        Dataset(dataset, LAYOUT).check()


def train(out, *more):
    options = ["--env", "tests.toy_env:Line", "--out", str(out), "--hidden", "8", "--batch-size", "8", "--actors", "0"]
    return main([*options, "--eval-worlds", "none", "--no-tensorboard", "--device", "cpu", *more])


def test_a_run_that_fails_on_its_dataset_is_not_in_the_way_of_the_next(dataset, tmp_path, capsys):
    good = (dataset / "shard-00000.npz").read_bytes()
    reward = np.zeros(12, np.float32)
    reward[9] = np.nan
    change_shard(dataset, shard(dataset, reward=reward))
    offline = ("--dataset", str(dataset), "--updates", "5")
    assert train(tmp_path / "run", *offline) == 1
    assert "episode 2: reward holds NaN" in capsys.readouterr().err
    change_shard(dataset, good)
    assert train(tmp_path / "run", *offline) == 0


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["--env", "os:system"], "--env os:system cannot be had: TypeError"),
        (["--env", "os:getcwd"], "--env os:getcwd cannot be had: TypeError: it is no gymnasium.Env"),
        (["--capacity", "1"], "a replay of 1 rows holds no transition; give a --capacity of at least 2"),
        (["--contact-seconds", "nan"], "nan"),
        (["--actors", "0", "--ray-address", "127.0.0.1:1"], "nothing would run there"),
    ],
)
def test_options_that_cannot_be_are_one_line(options, why, tmp_path, capsys):
    assert train(tmp_path / "run", *options) > 0
    error = capsys.readouterr().err.strip()
    assert error.startswith("train.py: ")
    assert "\n" not in error
    assert why in error
    assert not (tmp_path / "run" / "config.json").exists()


# -- bags --------------------------------------------------------------------------------------------------------------
def bag_with_chunk(path, packed, method):
    """A ROS 1 bag of one chunk of one connection."""

    def record(data=b"", **fields):
        head = b"".join(struct.pack("<I", len(n) + 1 + len(v)) + n.encode() + b"=" + v for n, v in fields.items())
        return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data)) + data

    u32, u64 = (lambda n: struct.pack("<I", n)), (lambda n: struct.pack("<Q", n))
    names = {"topic": b"/front/scan", "type": b"std_msgs/Bool", "md5sum": b"8b94c1b53db61fb6aed406028ad6332a"}
    definition = b"".join(
        struct.pack("<I", len(n) + 1 + len(v)) + n.encode() + b"=" + v
        for n, v in dict(names, message_definition=b"bool data\n").items()
    )
    start = b"#ROSBAG V2.0\n"
    first = len(start) + 4096
    chunk = record(packed, op=b"\x05", compression=method, size=u32(2**31))
    index = record(u32(1) + u32(0) + u32(0), op=b"\x04", ver=u32(1), conn=u32(0), count=u32(1))
    tail = record(definition, op=b"\x07", conn=u32(0), topic=b"/front/scan") + record(
        u32(0) + u32(1),
        op=b"\x06",
        ver=u32(1),
        chunk_pos=u64(first),
        start_time=u64(0),
        end_time=u64(0),
        count=u32(1),
    )
    fields = {"index_pos": u64(first + len(chunk) + len(index)), "conn_count": u32(1), "chunk_count": u32(1)}
    bare = record(b"", op=b"\x03", **fields)
    path.write_bytes(start + record(b" " * (4096 - len(bare)), op=b"\x03", **fields) + chunk + index + tail)


@pytest.mark.parametrize("method", ["bz2", "lz4"])
def test_a_bag_that_unpacks_to_too_much_is_one_line_in_little_memory(tmp_path, method, monkeypatch, measured):
    monkeypatch.setattr(compression, "MAX_UNPACKED", 1 << 22)
    pack = bz2.compress if method == "bz2" else lz4.frame.compress
    bag_with_chunk(tmp_path / "bomb.bag", pack(bytes(1 << 26)), method.encode())
    tracemalloc.start()
    try:
        with pytest.raises(reader.BagError, match="bomb.bag: .*unpacks to more than 4 MiB"):
            reader.read(tmp_path / "bomb.bag")
        peak = tracemalloc.get_traced_memory()[1]
        measured("memory for an archive of 64 MiB, bound 4 MiB", peak / 2**20, "MiB")
        assert peak < 1 << 24
    finally:
        tracemalloc.stop()


def test_compressed_data_are_what_they_were(tmp_path):
    data = os.urandom(3 << 20) + bytes(1 << 20)
    assert compression.unpack(bz2.BZ2Decompressor, bz2.compress(data) + bz2.compress(b"more")) == data + b"more"
    assert compression.unpack(lz4.frame.LZ4FrameDecompressor, lz4.frame.compress(data)) == data
    assert compression.unpack(compression.zstd.ZstdDecompressor, compression.zstd.compress(data)) == data
    for cut in (bz2.compress(data)[:-9], bz2.compress(data)[:100_000]):
        with pytest.raises(EOFError):
            compression.unpack(bz2.BZ2Decompressor, cut)


def test_bags_that_are_no_files(tmp_path):
    os.mkfifo(tmp_path / "pipe.bag")
    (tmp_path / "device.bag").symlink_to("/dev/zero")
    (tmp_path / "ros2").mkdir()
    os.mkfifo(tmp_path / "ros2" / "metadata.yaml")
    for name in ("pipe.bag", "device.bag", "ros2"):
        with pytest.raises(reader.BagError, match="is a pipe or device"):
            reader.read(tmp_path / name)


def test_a_stopped_demonstration_says_that_it_is_partial(tmp_path, monkeypatch, capsys):
    drive, commands = Demonstrator.command, []

    def stopped(self, *arguments):
        commands.append(1)
        if len(commands) > 150:
            raise KeyboardInterrupt
        return drive(self, *arguments)

    monkeypatch.setattr(Demonstrator, "command", stopped)
    bag = tmp_path / "part.bag"
    assert demonstrate.main([str(bag), "--world", "generated:0", "--simulator", "kinematic"]) == 130
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "part.bag holds a part of a demonstration" in error
    assert demonstration.read(bag).source["partial"] is True


# -- pipes and devices where a run keeps its files --------------------------------------------------------------------
@pytest.mark.parametrize("name", ["lock", "evaluations.jsonl", "journal/000000.segment"])
def test_a_pipe_in_a_runs_folder_is_one_line_at_once(name, tmp_path):
    from training.evaluation.periodic import _read
    from training.experience.journal import Journal
    from training.storage import Lock

    (tmp_path / "journal").mkdir()
    os.mkfifo(tmp_path / name)
    use = {"lock": Lock, "evaluations.jsonl": lambda folder: _read(folder / name)}
    with pytest.raises(ApplrError, match="pipe|cannot be locked") as problem:
        use.get(name, lambda folder: Journal(folder / "journal"))(tmp_path)
    assert "\n" not in str(problem.value)


def test_ctrl_c_during_imports_is_one_line():
    """Stopped by its own first import of numpy, as `python -m` is by a person within the first seconds."""
    code = (
        "import os, signal, sys, runpy\n"
        "class Stop:\n"
        "    def find_spec(self, name, *rest):\n"
        "        if name == 'numpy': os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Stop()); sys.argv = ['-m']\n"
        "runpy.run_module('%s', run_name='__main__', alter_sys=True)\n"
    )
    for module in ("training.evaluate", "worlds.draw", "sim_bridge.check"):
        ended = subprocess.run(
            [sys.executable, "-c", code % module],
            cwd=Path(__file__).parents[1],
            capture_output=True,
            text=True,
            check=False,
        )
        assert ended.returncode in (130, -signal.SIGINT)
        assert ended.stderr == "stopped\n"
