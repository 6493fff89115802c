"""The parameter policy: which parameters, what it sees, and the actor that decides. Free of ROS."""
