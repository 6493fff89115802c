"""Trajectories on disk: order, episodes that come twice, what is dropped, and files that are damaged or foreign."""

import sqlite3
from contextlib import closing

import numpy as np
import pytest

from applr_ros1.common.files import StorageError, sha256
from tests.support import episodes
from training.learner.learner import Learner, LearnerOptions
from training.replay.store import NAME, TrajectoryStore
from training.replay.trajectory import TrajectoryError, TransitionLayout

LAYOUT = TransitionLayout(4, 2, 2)


def episode(number, t=3, actor="a"):
    return episodes.episode(LAYOUT, number, t, actor, number % 2 == 0, **{"return": float(number)})


@pytest.fixture
def store(tmp_path):
    """A store of five episodes of three transitions."""
    made = TrajectoryStore(tmp_path / NAME, LAYOUT)
    for number in range(5):
        made.append(episode(number))
    return made


def test_what_is_appended_comes_back_in_order_also_to_another_reader(store, tmp_path):
    reader = TrajectoryStore(tmp_path)
    assert reader.layout == LAYOUT
    for found in (store, reader):
        back = list(found.trajectories())
        assert [number for number, _ in back] == [1, 2, 3, 4, 5]
        for number, (_, trajectory) in enumerate(back):
            expected = episode(number)
            assert (trajectory.info, trajectory.terminated) == (expected.info, expected.terminated)
            for name in ("scan", "rest", "action", "reward"):
                np.testing.assert_array_equal(getattr(trajectory, name), getattr(expected, name))
        assert [number for number, _ in found.trajectories(since=1, until=3)] == [2, 3]
        assert (found.last, found.transitions, found.rows) == (5, 15, 20)
        assert [i["transitions"] for i in found.infos()] == [3] * 5
        assert [i["return"] for i in found.infos(newest=2)] == [3.0, 4.0]
    digest = reader.digest()
    store.append(episode(9))
    assert reader.last == 6
    assert reader.digest() != digest


@pytest.mark.fault("20")
def test_the_same_episode_twice_is_refused_in_any_order(store):
    store.append(episode(8))
    store.forget(4 * 3 + 1)
    assert store.dropped() == (3, 9)
    assert [number for number, _ in store.trajectories()] == [4, 5, 6]
    assert len(store.infos()) == 6
    for number in (0, 8):
        with pytest.raises(TrajectoryError, match="came twice"):
            store.append(episode(number))
    store.append(episode(6))
    store.append(episode(8, actor="another"))
    assert (store.next_episode("a"), store.next_episode("another"), store.next_episode("nobody")) == (9, 9, 0)


def test_a_closed_store_is_one_file_that_can_be_moved(store, tmp_path):
    store.note("source", {"robot": "jackal"})
    store.close()
    assert [path.name for path in tmp_path.iterdir()] == [NAME]
    moved = (tmp_path / NAME).rename(tmp_path / "mine.sqlite")
    assert TrajectoryStore(moved).about("source") == {"robot": "jackal"}
    assert TrajectoryStore(moved).about("skipped") == {}


@pytest.mark.fault("18b")
def test_what_is_no_store_is_one_line(store, tmp_path):
    store.close()
    data = (tmp_path / NAME).read_bytes()
    (tmp_path / "cut").write_bytes(data[: len(data) // 2])
    (tmp_path / "text").write_text("no database at all\n" * 100)
    sqlite3.connect(tmp_path / "other").executescript("CREATE TABLE a (b); INSERT INTO a VALUES (1)")
    for name, words in (
        ("absent", "holds no trajectories"),
        ("text", "not a database"),
        ("other", "no such table|not a store"),
        ("cut", "malformed"),
    ):
        with pytest.raises(StorageError, match=words) as refused:
            list(TrajectoryStore(tmp_path / name).trajectories())
        assert "\n" not in str(refused.value)
    with pytest.raises(StorageError, match="its layout is .*, TransitionLayout.* is needed"):
        TrajectoryStore(tmp_path / NAME, TransitionLayout())
    with closing(sqlite3.connect(tmp_path / NAME, isolation_level=None)) as database:
        database.execute("PRAGMA user_version = 1")
    with pytest.raises(StorageError, match="not a store of trajectories of this version"):
        TrajectoryStore(tmp_path)


VIEW = "DROP TABLE episodes; CREATE VIEW episodes AS WITH RECURSIVE r(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM r) "


@pytest.mark.fault("18b")
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (VIEW + "SELECT id, '' AS sum FROM r", "more than plain tables"),
        ("CREATE TRIGGER t AFTER INSERT ON about BEGIN DELETE FROM episodes; END", "more than plain tables"),
        ("DROP TABLE about; CREATE TABLE about (name, value BLOB AS (zeroblob(1000000000)), sum)", "more than plain"),
        (("episodes", 2**62, "a", 9, 3, "{}"), "its newest episode is number 4611686018427387904"),
        (("episodes", 6, "a", 9, "many", "{}"), "cannot be used"),
        (("episodes", 6, "a", 9, 3, "[" * 100_000), "nested too deep"),
        (("about", "source", "{"), "cannot be used"),
        (("arrays", 2, 5), ""),
    ],
)
def test_what_a_stranger_made_is_one_line(store, tmp_path, change, words):
    """With right checksums."""
    store.close()
    with closing(sqlite3.connect(tmp_path / NAME, isolation_level=None)) as database:
        if isinstance(change, str):
            database.executescript(change)
        else:
            table, *row = change
            database.execute(f"REPLACE INTO {table} VALUES ({', '.join('?' * (len(row) + 1))})", (*row, sha256(*row)))

    def read():
        found = TrajectoryStore(tmp_path)
        return len(list(found.trajectories())), found.infos(), found.about("source")

    if not words:
        assert read()[0] == 4
        return
    with pytest.raises(StorageError, match=words) as refused:
        read()
    assert "\n" not in str(refused.value)


@pytest.mark.fault("18b")
def test_a_damaged_episode_is_named_and_left_out_and_nothing_else_comes_back_changed(store, tmp_path, capsys):
    store.note("source", {"period": 1.0})

    def read(store):
        episodes = [(number, str(vars(trajectory))) for number, trajectory in store.trajectories()]
        return dict(episodes), store.infos(), store.about("source")

    expected, infos, about = read(store)
    store.close()
    data, rng, named = (tmp_path / NAME).read_bytes(), np.random.default_rng(0), 0
    for at in rng.integers(100, len(data), 300):
        damaged = bytearray(data)
        damaged[at] ^= 1 << rng.integers(8)
        (tmp_path / "flipped").write_bytes(damaged)
        try:
            with closing(TrajectoryStore(tmp_path / "flipped")) as reader:
                found, told, source = read(reader)
        except StorageError:
            continue
        said = capsys.readouterr().err
        assert found.items() <= expected.items()
        assert all(info in infos for info in told)
        assert source == about
        for number in expected.keys() - found.keys():
            assert f"episode {number}: damaged and left out" in said
            named += 1
        assert (len(found), len(told)) == (5, 5) or "damaged" in said
    assert named > 10


@pytest.mark.fault("18b")
def test_rows_that_are_lost_without_a_trace_are_told(store, tmp_path, capsys):
    store.close()
    data = bytearray((tmp_path / NAME).read_bytes())
    page = next(at for at in range(4096, len(data), 4096) if data[at] == 13 and data[at + 4] == 5)
    data[page + 4] = 4  # rows of a leaf of a table
    (tmp_path / NAME).write_bytes(data)
    TrajectoryStore(tmp_path)
    assert "episodes may be missing" in capsys.readouterr().err
    with pytest.raises(StorageError, match="cannot be used"):
        TrajectoryStore(tmp_path, LAYOUT)


@pytest.mark.fault("18b")
@pytest.mark.parametrize("share", [0.3, 0.6, 0.97])
def test_a_file_that_was_cut_is_read_as_far_as_it_goes(tmp_path, capsys, share):
    with closing(TrajectoryStore(tmp_path / NAME, LAYOUT)) as store:
        for number in range(60):
            store.append(episode(number, 100))
        expected = {number: str(vars(trajectory)) for number, trajectory in store.trajectories()}
    data = (tmp_path / NAME).read_bytes()
    (tmp_path / NAME).write_bytes(data[: int(share * len(data))])
    with closing(TrajectoryStore(tmp_path)) as store:
        found = {number: str(vars(trajectory)) for number, trajectory in store.trajectories()}
    assert found.items() <= expected.items()
    assert len(found) > (share - 0.15) * len(expected)
    assert "episodes may be missing" in capsys.readouterr().err
    with pytest.raises(StorageError, match="cannot be used"):
        TrajectoryStore(tmp_path, LAYOUT)


@pytest.mark.fault("18b")
def test_a_run_goes_on_without_a_damaged_episode(tmp_path, capsys):
    options = LearnerOptions(net_arch=[8], batch_size=8, buffer_size=1000, device="cpu")
    learner = Learner(LAYOUT, options, tmp_path)
    for number in range(3):
        learner.take(episode(number, 10).pack())
    learner.save()
    learner.store.close()
    with closing(sqlite3.connect(tmp_path / NAME, isolation_level=None)) as database:
        database.execute("UPDATE arrays SET data = substr(data, 1, length(data) - 1) || x'00' WHERE id = 2")
    learner = Learner(LAYOUT, options, tmp_path)
    learner.resume()
    assert (learner.replay.held, learner.transitions) == (20, 30)
    assert "episode 2: damaged and left out" in capsys.readouterr().err


@pytest.mark.parametrize("ratio", [0.5, 2.0])
def test_another_ratio_of_updates_counts_from_the_resume_on(tmp_path, ratio):
    options = LearnerOptions(net_arch=[8], batch_size=8, buffer_size=1000, utd_ratio=1.0, device="cpu")
    learner = Learner(LAYOUT, options, tmp_path)
    for number in range(3):
        learner.take(episode(number, 10).pack())
    assert learner.train() == 30
    learner.save()
    for _ in range(2):  # the second time from a checkpoint that was made with the new ratio
        learner = Learner(LAYOUT, options.model_copy(update={"utd_ratio": ratio}), tmp_path)
        learner.resume()
        assert learner.td3.updates == 30
        learner.save()
    learner.take(episode(3, 10).pack())
    assert learner.train() == 10 * ratio
