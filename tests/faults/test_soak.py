"""What the soak says of the processes that it has watched."""

import pandas as pd
import pytest

pytest.importorskip("rospy")


def test_finds_a_leak_and_a_restart():
    from tests.faults import soak

    rows = [(60.0 * n, "leaking", 7, 100.0 + n / 6.0, 20 + n // 30, 5) for n in range(61)]
    rows += [(60.0 * n, "steady", 8 + (n > 40), 50.0, 10, 5) for n in range(61)]
    found = soak.summary(pd.DataFrame(rows, columns=soak.COLUMNS))
    assert found["leaking"]["mb_per_hour"] == 10.0
    assert found["leaking"]["descriptors"] == [20, 22]
    assert found["leaking"]["opening"]
    assert not found["steady"]["opening"]
    assert (found["steady"]["mb_per_hour"], found["steady"]["restarts"]) == (0.0, 1)
