"""Collision monitor: a classical safety check between the planner and the base.

CollisionMonitor takes every scan and every command. It passes the fastest command after which the
base can still stop before it touches anything. The ROS node, the training environment and the
evaluation use the same class, which does not depend on ROS.
"""
