"""Tests of the memory of the last minutes."""

import numpy as np
import pytest

from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.columns import SECOND
from applr_ros1.why.black_box.bag_file import Publication, RawMessage
from applr_ros1.why.black_box.ring import BLOCK_BYTES, MESSAGE_BYTES, Ring, RouteFilter, size_of

SCAN = Publication("/scan", "sensor_msgs/LaserScan", "")
PLAN = Publication("/plan", "nav_msgs/Path", "")
OTHER_PLAN = PLAN._replace(publisher="/another")


def message(seconds, publication=SCAN, data=b"scan"):
    """Return a message that came at a time [s]."""
    return RawMessage(round(seconds * SECOND), publication, data)


def test_the_last_seconds_are_kept():
    ring = Ring(10.0, 10**6)
    messages = [message(0.5 * step) for step in range(41)]
    for sent in messages:
        ring.add(sent)
    # The last one came at 20 s.
    assert list(ring.messages()) == messages[20:]
    assert ring.seconds == 10.0
    assert list(ring.messages(begin=19 * SECOND)) == messages[38:]


def test_memory_is_bounded_and_the_oldest_leave_first():
    size = MESSAGE_BYTES + 1000
    ring = Ring(1000.0, 20 * size)
    messages = [message(step, data=b"x" * 1000) for step in range(50)]
    for sent in messages:
        ring.add(sent)
    assert list(ring.messages()) == messages[-20:]
    assert ring.byte_count == 20 * size
    # A message that is larger than a tenth is left out, and drives no others out.
    with pytest.raises(
        ApplrError, match=r"a message of 10\.0 MB is left out: send at most 0\.0 MB"
    ):
        ring.add(message(51.0, PLAN, data=b"x" * 10_000_000), holds=True)
    assert list(ring.messages()) == messages[-20:]


def test_memory_of_what_holds_counts():
    ring = Ring(1000.0, 100_000)
    for step in range(100):
        # The plans of many planners, which fill the memory at last, or of a few
        planner = step if step < 30 else step % 3
        plan = PLAN._replace(publisher=f"/planner_{planner}")
        ring.add(message(step, plan, b"x" * 5000), holds=True)
        assert sum(map(size_of, ring.messages())) == ring.byte_count <= 100_000
    assert len(list(ring.messages())) == 19


def test_what_holds_until_the_next_message_stands_at_the_begin():
    ring = Ring(10.0, 10**6)
    ring.add(message(0.0, PLAN, b"first"), holds=True)
    ring.add(message(1.0, PLAN, b"second"), holds=True)
    ring.add(message(1.0, OTHER_PLAN, b"another"), holds=True)
    for second in range(2, 31):
        ring.add(message(second))
    first, second, *scans = ring.messages()
    assert {first.data, second.data} == {b"second", b"another"}
    assert first.time == second.time == 20 * SECOND
    assert len(scans) == 11

    # The same where the begin lies within what is kept
    ring.add(message(31.0, PLAN, b"third"), holds=True)
    ring.add(message(32.0))
    assert {entry.data for entry in ring.messages(32 * SECOND)} == {b"third", b"another", b"scan"}


def test_beside_followed_plans_routes_are_kept_once_a_second():
    full = b"x" * 5000
    empty = b"x" * 28
    routes = RouteFilter()

    def kept(key, begin, end, data=full):
        """Return the number of messages that are kept of those at 20 Hz from begin to end [s]."""
        times = [begin + 0.05 * step for step in range(round((end - begin) * 20))]
        return sum(routes.keeps(key, message(time, PLAN, data)) for time in times)

    # Without followed plans, the replay cuts them from all routes.
    assert kept("routes", 0.0, 2.0) == 40
    for second in range(2, 12):
        assert kept("plans", second, second + 1) == 20
        assert kept("routes", second, second + 1) <= 2
    # A plan that is lost or found is kept at once.
    assert kept("plans", 12.0, 12.05) == 1
    assert kept("routes", 12.05, 12.1, empty) == 1
    assert kept("routes", 12.1, 12.2, full) == 1
    # Empty followed plans say nothing, and after a jump of the clock nothing is known.
    assert kept("plans", 14.0, 15.0, empty) == 20
    assert kept("routes", 15.0, 16.0) == 20
    assert kept("plans", 3.0, 3.05) == 1
    assert kept("routes", 3.05, 3.1) == 1


def test_a_message_that_waited_on_a_busy_computer_is_added_to_the_others():
    ring = Ring(60.0, 10**7)
    sent = [message(100.0 + 0.1 * step) for step in range(600)]
    late_message = message(159.9 - 5.0, PLAN)
    for entry in (*sent, late_message):
        ring.add(entry)
    assert list(ring.messages()) == [*sent, late_message]
    assert ring.seconds == pytest.approx(59.9)


def test_begun_anew_it_has_only_what_holds():
    ring = Ring(10.0, 10**6)
    ring.add(message(100.0))
    ring.add(message(100.5, PLAN, b"plan"), holds=True)
    ring.start_anew()
    assert ring.seconds == 0.0
    ring.add(message(3.0))
    plan, scan = ring.messages()
    assert (plan.data, plan.time) == (b"plan", 3 * SECOND)
    assert scan.time == 3 * SECOND


def test_messages_in_blocks_come_back_as_they_came():
    ring = Ring(60.0, 10**8)
    rng = np.random.default_rng(0)
    sent = []
    for step in range(600):
        publication = (SCAN, PLAN, OTHER_PLAN)[step % 3]
        entry = message(0.1 * step, publication, rng.bytes(int(rng.integers(0, 6000))))
        ring.add(entry, holds=publication != SCAN)
        sent.append(entry)
    assert sum(len(entry.data) for entry in sent) > 4 * BLOCK_BYTES
    assert list(ring.messages()) == sent
    assert ring.seconds == pytest.approx(59.9)

    # What holds at a begin is found in blocks that lie before it, too.
    plan, other_plan, *later_messages = ring.messages(begin=55 * SECOND)
    assert later_messages == sent[550:]
    assert {plan.data, other_plan.data} == {sent[548].data, sent[547].data}
    assert plan.time == other_plan.time == 55 * SECOND

    # Blocks leave as a whole. What is older than the ring's time is not shown.
    for step in range(600, 1000):
        entry = message(0.1 * step, SCAN, rng.bytes(6000))
        ring.add(entry)
        sent.append(entry)
    later_messages = list(ring.messages())
    assert {entry.data for entry in later_messages[:2]} == {sent[397].data, sent[398].data}
    assert later_messages[2:] == sent[399:]
    assert ring.seconds == 60.0


def test_what_was_asked_for_stays_while_the_ring_goes_on():
    ring = Ring(10.0, 10**8)
    sent = [message(0.1 * step, data=bytes(5000)) for step in range(100)]
    for entry in sent:
        ring.add(entry)
    asked_messages = ring.messages()
    ring.add(message(1000.0))
    assert list(asked_messages) == sent


def test_messages_that_repeat_take_a_fraction_of_their_size():
    ring = Ring(600.0, 10**8)
    plan = np.random.default_rng(0).bytes(10_000)
    for step in range(1000):
        ring.add(message(step, PLAN, step.to_bytes(4, "little") + plan))
    assert ring.byte_count < 0.1 * 1000 * 10_000

    small_ring = Ring(600.0, 110_000)
    for step in range(1000):
        small_ring.add(message(step, PLAN, step.to_bytes(4, "little") + plan))
    kept_messages = list(small_ring.messages())
    assert small_ring.byte_count <= 110_000
    assert kept_messages[-1].time == 999 * SECOND
