"""A robot's description: made from its URDF (./applr robot), and checked with test drives on open floor."""
