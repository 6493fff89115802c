"""A robot's description: made from its URDF (./applr robot), and checked on open floor."""
