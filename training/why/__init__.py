"""Desk side of applr_ros1/why (./applr why): drives in the world that was seen, remedies, pages."""
