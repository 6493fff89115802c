"""The critics of DWAPlannerROS, one file each. registry.py has them in the order of C++.

A critic's file has its description, CRITIC (critic.py), and a kernel `value` whose arguments are
any of those of registry.value. A negative value refuses the trajectory. A critic that reads a
distance grid has no kernel, and its value's lower bound is found before the roll-out (bounds.py).
Otherwise a kernel `bound` may return one, of arguments of registry.lower_bound; without it, the
bound is 0. See docs/explanation/planner_dwa.md, section 6.
"""
