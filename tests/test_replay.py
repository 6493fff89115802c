"""The replay: what is stored, what is drawn, what is refused; and its journal on disk."""

import os
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from applr_ros1.common.files import StorageError
from training.experience.journal import Journal
from training.experience.replay import Replay
from training.experience.trajectory import Layout, Trajectory, TrajectoryError
from training.gorila.batch import draw_batch
from training.gorila.learner import Learner, LearnerConfig
from training.td3.td3 import TD3Config

SMALL = Layout(scan=4, rest=2, action=2)


def episode(t, number=0, terminated=False, actor="a", layout=SMALL, rng=None, rewards=None):
    rng = rng or np.random.default_rng(number)
    observations = rng.uniform(-1, 1, (t + 1, layout.size))
    return Trajectory.of(
        layout,
        observations,
        rng.uniform(-1, 1, (t, layout.action)),
        rng.normal(size=t) if rewards is None else rewards,
        terminated,
        {"actor": actor, "episode": number},
    )


def test_the_papers_five_million_transitions_fit_in_eight_gigabytes():
    replay = Replay(Layout(), 5_500_000)  # allocated lazily: costs nothing here
    assert replay.nbytes < 4.5e9
    assert Layout().step * 1.0 == pytest.approx(2 / 255)  # of [-1, 1], which is 2 m: 7.8 mm


def test_the_scan_comes_back_within_half_a_step():
    layout = Layout()
    observations = np.random.default_rng(0).uniform(-1, 1, (5, layout.size)).astype(np.float32)
    back = layout.restore(layout.quantise(observations), observations[:, layout.scan :])
    assert np.abs(back - observations)[:, :720].max() <= layout.step / 2 + 1e-6
    assert np.array_equal(back[:, 720:], observations[:, 720:])
    edges = np.zeros((1, layout.size), np.float32)
    edges[0, :3] = -1, 1, 5  # beyond the range: clipped, not wrapped
    assert layout.quantise(edges)[0, :3].tolist() == [0, 255, 255]


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.integers(1, 9), st.booleans()), min_size=1, max_size=12),
    st.integers(12, 40),
    st.integers(1, 5),
)
def test_samples_are_the_episodes_own_n_step_transitions(lengths, capacity, n):
    """Against a plain list of episodes, in a ring that has been around several times."""
    gamma, replay, truth = 0.9, Replay(SMALL, capacity), {}
    for number, (t, terminated) in enumerate(lengths):
        trajectory = episode(t, number, terminated)
        replay.add(trajectory)
        for k in range(t):
            m = min(n, t - k)
            total = sum(gamma**i * float(trajectory.reward[k + i]) for i in range(m))
            ended = terminated and k + m == t
            truth[trajectory.rest[k].tobytes()] = (
                total,
                0.0 if ended else gamma**m,
                trajectory.rest[k + m],
                trajectory.scan[k + m],
                trajectory.action[k],
                trajectory.scan[k],
            )
    rng = np.random.default_rng(0)
    rows = replay.draw(rng, 200)
    rewards, discounts, following = replay.n_step_return(rows, n, gamma)
    for row, reward, discount, after in zip(rows, rewards, discounts, following):
        total, factor, rest, scan, action, here = truth[replay.rest[row].tobytes()]
        assert reward == pytest.approx(total, abs=1e-5)
        assert discount == pytest.approx(factor)
        assert np.array_equal(replay.rest[after], rest)
        assert np.array_equal(replay.scan[after], scan)
        assert np.array_equal(replay.action[row], action)
        assert np.array_equal(replay.scan[row], here)
    assert replay.held == np.count_nonzero(replay.end != 3)
    assert replay.transitions == sum(t for t, _ in lengths)


def test_every_transition_is_drawn_equally_often():
    replay = Replay(SMALL, 100)
    for number, t in enumerate((1, 2, 10)):
        replay.add(episode(t, number))
    counts = np.bincount(replay.draw(np.random.default_rng(0), 130_000), minlength=16)
    assert np.count_nonzero(counts) == 13
    assert counts[counts > 0].min() > 9_600
    assert counts.max() < 10_400


def test_batch_is_what_the_rows_say():
    replay = Replay(SMALL, 50)
    trajectory = episode(5, terminated=True)
    replay.add(trajectory)
    batch = draw_batch(replay, np.random.default_rng(0), 64, 1, 0.9)
    observations = SMALL.restore(trajectory.scan, trajectory.rest)
    for i in range(64):
        k = int(np.argmin(np.abs(observations - batch.observation[i].numpy()).sum(1)))
        np.testing.assert_allclose(batch.observation[i], observations[k], atol=1e-6)
        np.testing.assert_allclose(batch.next_observation[i], observations[k + 1], atol=1e-6)
        assert float(batch.discount[i]) == pytest.approx(0.0 if k == 4 else 0.9)


def test_mirror_turns_half_of_a_batch_left_for_right():
    replay = Replay(SMALL, 50)
    replay.add(episode(5, terminated=True))
    plain, mirrored = (draw_batch(replay, np.random.default_rng(0), 64, 1, 0.9, mirror=m) for m in (False, True))
    for name in ("observation", "next_observation"):
        ours, theirs = getattr(mirrored, name).numpy(), getattr(plain, name).numpy()
        np.testing.assert_array_equal(ours[32:], theirs[32:])
        np.testing.assert_array_equal(ours[:32, : SMALL.scan], theirs[:32, : SMALL.scan][:, ::-1])
        np.testing.assert_array_equal(ours[:32, SMALL.scan], -theirs[:32, SMALL.scan])
        np.testing.assert_array_equal(ours[:32, SMALL.scan + 1 :], theirs[:32, SMALL.scan + 1 :])
    for name in ("action", "reward", "discount", "noise"):
        np.testing.assert_array_equal(getattr(mirrored, name), getattr(plain, name))


def broken(change):
    trajectory = episode(3)
    change(trajectory)
    return trajectory


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda t: t.rest.__setitem__((1, 0), np.nan), "rest holds NaN"),
        (lambda t: t.reward.__setitem__(0, np.inf), "reward holds NaN or inf"),
        (lambda t: t.action.__setitem__((0, 0), 1.5), "outside"),
        (lambda t: setattr(t, "scan", t.scan[:-1]), "scan is uint8"),
        (lambda t: setattr(t, "scan", t.scan.astype(np.float32)), "scan is float32"),
        (lambda t: setattr(t, "reward", np.zeros(0, np.float32)), "0 transitions"),
        (lambda t: t.info.pop("actor"), "no valid actor"),
        (lambda t: t.info.update(episode=-1), "no valid actor"),
        (lambda t: t.info.update(episode="1"), "no valid actor"),
    ],
)
def test_malformed_trajectories_are_refused_and_leave_no_trace(change, why):
    replay = Replay(SMALL, 50)
    replay.add(episode(4, 7))
    with pytest.raises(TrajectoryError, match=why):
        replay.add(broken(change))
    assert (replay.written, replay.transitions, replay.held) == (5, 4, 4)


def test_the_same_episode_twice_is_refused_in_any_order():
    replay = Replay(SMALL, 200)
    for number in (3, 0, 2):
        replay.add(episode(2, number))
        with pytest.raises(TrajectoryError, match="twice"):
            replay.add(episode(2, number))
    replay.add(episode(2, 1))
    replay.add(episode(2, 3, actor="another"))
    assert replay.episodes_of("a") == 4
    assert replay.episodes_of("nobody") == 0
    with pytest.raises(TrajectoryError, match="do not fit"):
        Replay(SMALL, 3).add(episode(4))


def test_bytes_there_and_back_and_nonsense_refused():
    trajectory = episode(3, 5, True)
    trajectory.info["return"] = -1.5
    back = Trajectory.unpack(trajectory.pack())
    assert back.info == trajectory.info
    assert back.terminated is True
    assert all(np.array_equal(getattr(back, k), getattr(trajectory, k)) for k in ("scan", "rest", "action", "reward"))
    blob = trajectory.pack()
    for nonsense in (b"", b"{}", blob[:50], blob[:-5], b"\x80\x04K\x01.", os.urandom(500), b"\xff" * 100):
        with pytest.raises(TrajectoryError):
            Trajectory.unpack(nonsense)


def test_journal_keeps_order_and_drops_only_a_torn_last_record(tmp_path, caplog):
    journal = Journal(tmp_path, segment_bytes=200)
    blobs = [bytes([i]) * 90 for i in range(1, 9)]
    places = []
    for i, blob in enumerate(blobs):
        journal.append(blob, {"rows": i})
        places.append(journal.place)
    journal.close()
    assert len(list(tmp_path.glob("*.segment"))) > 2
    again = Journal(tmp_path, segment_bytes=200)
    assert list(again.read()) == blobs
    assert list(again.read(since=places[2])) == blobs[3:]
    assert list(again.read(until=places[2])) == blobs[:3]
    with open(again._path(again.segments[-1]), "ab") as file:
        file.write(b"APTR\x20\x00\x00\x00half a rec")
    torn = Journal(tmp_path, segment_bytes=200)
    assert list(torn.read()) == blobs
    assert not caplog.records
    torn.append(b"more", {"rows": 8})
    assert list(Journal(tmp_path).read()) == blobs + [b"more"]
    torn.forget_before(5)
    kept = list(Journal(tmp_path).read())
    assert blobs[5] in kept
    assert kept[-1] == b"more"
    assert blobs[0] not in kept


def test_journal_says_when_a_checkpoint_needs_more_than_is_there(tmp_path):
    journal = Journal(tmp_path)
    journal.append(b"x" * 50, {})
    place = journal.place
    journal.close()
    os.truncate(tmp_path / "000000.segment", 60)
    with pytest.raises(StorageError, match="missing or damaged"):
        list(Journal(tmp_path).read(until=place))


@pytest.mark.parametrize("left", [0, 5, 20])
def test_a_segment_that_was_only_begun_is_dropped_by_the_next_record_and_not_by_reading(tmp_path, left):
    journal = Journal(tmp_path / "journal")
    assert list(journal.read()) == []
    assert not (tmp_path / "journal").exists()
    journal.append(b"first", {})
    journal.close()
    begun = tmp_path / "journal" / "000001.segment"
    begun.write_bytes((tmp_path / "journal" / "000000.segment").read_bytes()[:left])
    left = begun.read_bytes()
    again = Journal(tmp_path / "journal", segment_bytes=10)
    assert list(again.read()) == [b"first"]
    assert begun.read_bytes() == left
    again.append(b"second", {})
    assert list(Journal(tmp_path / "journal").read()) == [b"first", b"second"]


@pytest.mark.parametrize("segment", [0, 1])
def test_a_damaged_beginning_of_a_segment_is_said_and_deletes_nothing(tmp_path, segment):
    journal = Journal(tmp_path, segment_bytes=10)
    journal.append(b"first", {})
    journal.append(b"second", {})
    journal.close()
    path = tmp_path / ("%06d.segment" % segment)
    damaged = bytes([path.read_bytes()[0] ^ 1]) + path.read_bytes()[1:]
    path.write_bytes(damaged)
    with pytest.raises(StorageError, match="%s: its beginning is damaged or missing; put a copy" % path.name):
        Journal(tmp_path)
    assert path.read_bytes() == damaged


def flipped(path, place):
    """The file's content with one bit of a byte turned over, which is then also on the disk."""
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    path.write_bytes(data)
    return bytes(data)


@pytest.mark.parametrize("field", [0, 5, 8, 40])
@pytest.mark.parametrize("last", [True, False])
def test_damage_amid_a_segment_is_said_and_loses_no_more(tmp_path, caplog, field, last):
    """In the magic, the length, the checksum or the payload of the third of six records."""
    journal, places = Journal(tmp_path), []
    for i in range(1, 7):
        journal.append(bytes([i]) * 60, {"rows": i})
        places.append(journal.offset)
    journal.close()
    if not last:
        journal.segment_bytes = 10
        journal.append(b"in another segment", {})
        journal.close()
    more = [] if last else [b"in another segment"]
    path = tmp_path / "000000.segment"
    damaged = flipped(path, places[1] + field)
    again = Journal(tmp_path)
    assert list(again.read()) == [bytes([1]) * 60, bytes([2]) * 60] + more
    assert list(again.read(since=[0, places[0]])) == [bytes([2]) * 60] + more
    left = "damaged at byte %d: the %d bytes from there on are not read" % (places[1], len(damaged) - places[1])
    (record,) = caplog.records
    assert record.getMessage().startswith("%s: %s; a copy of" % (path, left))
    again.append(b"more", {"rows": 2})
    place = again.place
    again.close()
    assert path.read_bytes() == damaged
    assert list(Journal(tmp_path).read(until=place)) == [bytes([1]) * 60, bytes([2]) * 60] + more + [b"more"]


def test_a_whole_segment_is_not_taken_for_one_that_was_only_begun(tmp_path):
    journal = Journal(tmp_path)
    journal.append(b"first", {})
    journal.close()
    damaged = flipped(tmp_path / "000000.segment", 6)  # the header's record ends behind the file
    with pytest.raises(StorageError, match="its beginning is damaged"):
        Journal(tmp_path).append(b"second", {})
    assert (tmp_path / "000000.segment").read_bytes() == damaged


def test_journal_on_a_full_disk_stays_whole(tmp_path, monkeypatch):
    journal = Journal(tmp_path)
    journal.append(b"first", {})

    def full(descriptor, data):
        if len(data) > 7:
            return real(descriptor, data[:7])
        raise OSError(28, "No space left on device")

    real = os.write
    monkeypatch.setattr(os, "write", full)
    with pytest.raises(StorageError, match="No space left.*--resume"):
        journal.append(b"second, which is long", {})
    monkeypatch.undo()
    assert list(Journal(tmp_path).read()) == [b"first"]


def test_a_replay_that_memory_cannot_hold_is_refused(monkeypatch):
    monkeypatch.setattr(
        "training.experience.replay.os.sysconf", lambda name: 4096 if "SIZE" in name else 2**20
    )  # 4 GiB
    with pytest.raises(ValueError, match=r"a replay of 100000000 rows takes 79\.3 GB, this machine has 4\.3 GB; give"):
        Replay(Layout(), 10**8)


@pytest.mark.parametrize("ratio", [0.5, 2.0])
def test_another_number_of_updates_per_transition_counts_from_the_resume_on(tmp_path, ratio):
    config = LearnerConfig(TD3Config(hidden=(8,), batch_size=8), 1000, updates_per_transition=1.0)
    learner = Learner(SMALL, config, tmp_path)
    for number in range(3):
        learner.take(episode(10, number).pack())
    assert learner.train() == 30
    learner.save()
    for _ in range(2):  # the second time from a checkpoint that was made with the new ratio
        learner = Learner(SMALL, replace(config, updates_per_transition=ratio), tmp_path)
        learner.resume()
        assert learner.td3.updates == 30
        learner.save()
    learner.take(episode(10, 3).pack())
    assert learner.train() == 10 * ratio
