"""What a desk adds to applr_ros1/why (./applr why): drives in the world seen, remedies, pages."""
