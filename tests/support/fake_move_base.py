"""Stand-in for move_base in tests: its dynamic_reconfigure servers, with switches that make them misbehave.

    fake_move_base.py [--spelling kinetic] [--layer NAME] [--without NAME] [--robot NAME] [--text CODE]
These ROS parameters are lists of servers that misbehave. Servers in /fake/refuse raise an error. Those in /fake/hold
keep and report their old values. Those in /fake/lie keep their old values, but report the new ones. Those in /fake/late
publish their values 0.2 s late. Those in /fake/hang do not answer until they are removed from the list.
"""

import argparse
import sys
import threading
from types import SimpleNamespace

import rospy
from dynamic_reconfigure.encoding import decode_config, encode_config
from dynamic_reconfigure.server import Server
from dynamic_reconfigure.srv import ReconfigureResponse

from applr_ros1.planner.parameters import check
from applr_ros1.planner.parameters.declarations import SERVERS, servers
from applr_ros1.robots import load

KINETIC = {"path_distance_bias": "pdist_scale", "goal_distance_bias": "gdist_scale"}


def config_type(parameters, code=""):
    """Return dynamic_reconfigure's description of a group of parameters, as a .cfg file would generate it.

    With `code`, max_vel_x is a string whose choices the server describes by this Python code.
    """
    always = {"level": 0, "edit_method": ""}
    rows = [
        dict(
            always,
            name=name,
            type=p.type,
            default=p.default,
            description=p.doc,
            min=p.min,
            max=p.max,
        )
        for name, p in parameters
    ]
    for row in (row for row in rows if code and row["name"] == "max_vel_x"):
        row.update(type="str", edit_method=code)
    names = {
        "name": "Default",
        "parentname": "Default",
        "upper": "DEFAULT",
        "lower": "groups",
        "field": "default",
    }
    kinds = {"type": "", "class": "DEFAULT", "parentclass": "", "cstate": "true"}
    group = {
        **names,
        **kinds,
        "id": 0,
        "parent": 0,
        "state": True,
        "groups": [],
        "parameters": rows,
    }
    return SimpleNamespace(
        config_description=group,
        min={r["name"]: r["min"] for r in rows},
        max={r["name"]: r["max"] for r in rows},
        defaults={r["name"]: r["default"] for r in rows},
        level={r["name"]: 0 for r in rows},
        type={r["name"]: r["type"] for r in rows},
    )


class Liar(Server):
    """Server that publishes its values late if it is in /fake/late, and confirms without applying if in /fake/lie."""

    def _set_callback(self, request):
        if self.ns.rstrip("/") in rospy.get_param("/fake/late", []):
            topic = self.update_topic
            late = SimpleNamespace(
                publish=lambda message: threading.Timer(0.2, topic.publish, [message]).start()
            )
            self.update_topic = late
            try:
                return super()._set_callback(request)
            finally:
                self.update_topic = topic
        if self.ns.rstrip("/") not in rospy.get_param("/fake/lie", []):
            return super()._set_callback(request)
        asked = decode_config(request.config, self.type.config_description)
        self.update_topic.publish(encode_config(self.config))
        return ReconfigureResponse(encode_config({**self.config, **asked}))


def serve(name, parameters, code=""):
    """Start the server `name`."""
    begun = []

    def callback(config, level):
        while begun and name in rospy.get_param("/fake/hang", []):
            rospy.rostime.wallsleep(0.05)
        if begun and name in rospy.get_param("/fake/refuse", []):
            raise RuntimeError("refused on request")
        if begun and name in rospy.get_param("/fake/hold", []):
            return begun[-1].copy()
        begun[:] = [config.copy()]
        return config

    return Liar(config_type(parameters, code), callback, name)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--spelling", default="noetic")
    parser.add_argument("--layer", default="inflater_layer")
    parser.add_argument("--without", default="")
    parser.add_argument(
        "--robot", default="", help="robot whose move_base has the servers to start instead"
    )
    parser.add_argument(
        "--text", default="", metavar="CODE", help="code of the choices of max_vel_x, a string"
    )
    args = parser.parse_args(rospy.myargv()[1:])
    rospy.init_node("move_base")
    if args.robot:
        declared = servers(check.complete(load(args.robot).parameters()))
        served = {name: server.parameters for name, server in declared.items()}
    else:
        served = {
            "TrajectoryPlannerROS": [
                p for p in SERVERS["TrajectoryPlannerROS"] if p.name != args.without
            ]
        }
        for costmap in ("local_costmap", "global_costmap"):
            served[costmap] = SERVERS[costmap]
            served[costmap + "/" + args.layer] = SERVERS["local_costmap/inflater_layer"]
            served[costmap + "/a_layer"] = SERVERS["local_costmap/obstacles_layer"]
    renamed = KINETIC if args.spelling == "kinetic" else {}
    named = {
        rospy.get_name() + ("/" + name if name else ""): parameters
        for name, parameters in served.items()
    }
    for full, parameters in named.items():
        serve(full, [(renamed.get(p.name, p.name), p) for p in parameters], args.text)
    print("all up", flush=True)
    rospy.spin()


if __name__ == "__main__":
    sys.exit(main())
