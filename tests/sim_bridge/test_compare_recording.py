"""training.compare_recording: a drive on Gazebo's ground is followed there, and not on plain ground."""

import re

from applr_ros1 import robots
from tests.support.scenes import STEP, drive, small_world
from training import compare_recording


def test_a_recorded_drive_is_followed_on_its_own_ground(tmp_path, capsys):
    simulator = compare_recording.standing_in(robots.load("jackal"), "gazebo")
    simulator.reset(small_world(), 0)
    simulator.set_motion((0.0, 0.0, 0.0), (0.0, 0.0), (0.0, 0.0))
    rows = ["t,cmd_v,cmd_w,x,y,yaw"]
    for k in range(60):
        v, w = (1.0, 1.0) if k < 40 else (0.5, -1.5)
        rows.append(",".join("%.6f" % value for value in (k * STEP, v, w, *simulator.state.pose)))
        drive(simulator, v, w, STEP)
    (tmp_path / "turns.csv").write_text("\n".join(rows))
    assert compare_recording.main([str(tmp_path / "turns.csv")]) == 0
    numbers = re.search(r"mean +(\S+) m +(\S+) rad +(\S+) m +(\S+) rad", capsys.readouterr().out).groups()
    plain, plain_turn, own, own_turn = map(float, numbers)
    assert own < 0.5 * plain
    assert own_turn < 0.5 * plain_turn
    (tmp_path / "none.csv").write_text("t,x\n1,2\n")
    assert compare_recording.main([str(tmp_path / "none.csv")]) == 1
    assert "give a CSV with the columns t, cmd_v" in capsys.readouterr().err
    (tmp_path / "cut.bag").write_bytes(b"#ROSBAG V2.0\n")
    assert compare_recording.main([str(tmp_path / "cut.bag")]) == 1
    assert "cut.bag: damaged or not a bag" in capsys.readouterr().err
