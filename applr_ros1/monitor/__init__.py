"""The collision monitor: a classical check between whatever chooses velocities and the base.

No ROS in it. CollisionMonitor takes every scan and every command and lets through the fastest command after which the
base can still stop before it touches anything. The ROS node, the training environment and evaluation use the same
object.
"""
# Imports planner/costmap, robots and common; no ROS.
