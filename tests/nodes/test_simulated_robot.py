"""Test of the refusal to simulate a robot beside a real one."""

from sim_bridge.ros_bridge import refuse_beside_a_robot
from tests.support.refusals import refused

TOPICS = ["/odometry/filtered", "/front/scan"]


def test_no_simulated_robot_starts_beside_a_real_one():
    """Without sim:=false, or with a misspelt one, the simulated robot's scans would move the real
    one.
    """

    def start(*publishers):
        refuse_beside_a_robot(TOPICS, publishers, "/sim_bridge")

    start()
    start(("/tf", ["/driver"]), ("/rear/scan", ["/driver"]))
    # The master may still know an earlier node that was killed.
    start(("/front/scan", ["/sim_bridge"]))
    problem = "^/driver publishes /front/scan already: give sim:=false for a real robot"
    refused(lambda: start(("/front/scan", ["/sim_bridge", "/driver"])), problem)
