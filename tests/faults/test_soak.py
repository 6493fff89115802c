"""What the soak says of the processes that it has watched."""

from tests.faults import soak


def test_finds_a_leak_and_a_restart():
    rows = [(60.0 * n, 30.0 * n, "leaking", 7, 100.0 + n / 6.0, 20 + n // 30, 5) for n in range(61)]
    rows += [(60.0 * n, 30.0 * n, "steady", 8 + (n > 40), 50.0, 10, 5) for n in range(61)]
    table_of = soak.summary(rows)
    assert table_of["leaking"]["mb_per_hour"] == 10.0
    assert table_of["leaking"]["descriptors"] == [20, 22]
    assert table_of["leaking"]["opening"]
    assert not table_of["steady"]["opening"]
    assert (table_of["steady"]["mb_per_hour"], table_of["steady"]["restarts"]) == (0.0, 1)
