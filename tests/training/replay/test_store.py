"""Trajectories on disk: order, episodes that come twice, what is dropped, and files that are damaged or foreign."""

import sqlite3

import numpy as np
import pytest

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import StorageError
from training.learner.learner import Learner, LearnerOptions
from training.replay.store import NAME, Store, dataset
from training.replay.trajectory import Layout, Trajectory, TrajectoryError

LAYOUT = Layout(4, 2, 2)


def episode(number, t=3, actor="a", layout=LAYOUT, **info):
    rng = np.random.default_rng(number)
    observations, actions = rng.uniform(-1, 1, (t + 1, layout.size)), rng.uniform(-1, 1, (t, layout.action))
    about = {"actor": actor, "episode": number, "return": float(number), **info}
    return Trajectory.of(layout, observations, actions, rng.normal(size=t), number % 2 == 0, about)


@pytest.fixture
def store(tmp_path):
    """A store of five episodes of three transitions."""
    made = Store(tmp_path / NAME, LAYOUT)
    for number in range(5):
        made.append(episode(number))
    return made


def test_what_is_appended_comes_back_in_order_also_to_another_reader(store, tmp_path):
    reader = Store(tmp_path)
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
        assert [i["transitions"] for i in found.infos()] == [3, 6, 9, 12, 15]
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
    assert Store(moved).about("source") == {"robot": "jackal"}
    assert Store(moved).about("skipped") == {}


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
            list(Store(tmp_path / name).trajectories())
        assert "\n" not in str(refused.value)
    with pytest.raises(StorageError, match="its layout is .*, Layout.* is needed"):
        Store(tmp_path / NAME, Layout())
    with pytest.raises(ApplrError, match="its layout is"):
        dataset(tmp_path, Layout())
    assert dataset(tmp_path, LAYOUT).last == 5
    (tmp_path / "empty").mkdir()
    Store(tmp_path / "empty" / NAME, LAYOUT).close()
    with pytest.raises(ApplrError, match="holds no transitions"):
        dataset(tmp_path / "empty")


@pytest.mark.fault("18b")
def test_a_trajectory_that_is_spoilt_on_disk_is_one_line(store, tmp_path):
    store.close()
    spoilt = episode(2)
    spoilt.reward[1] = np.nan
    database = sqlite3.connect(tmp_path / NAME)
    database.execute("UPDATE arrays SET data = ? WHERE id = 3", (spoilt.pack(),))
    database.commit()
    with pytest.raises(StorageError, match=f"{NAME}: episode 3: reward holds NaN"):
        dataset(tmp_path)


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
