"""The critics of DWAPlannerROS, one file each; registry.py has the lists of all.

A critic's file has its row on the page of rules (ROW), and three kernels: the weight, the value of
a trajectory, and a lower bound of this value that is known before the roll-out. A negative value
refuses the trajectory. See docs/explanation/planner_dwa.md, section 6.
"""
