"""Benchmarks: measurements of speed and of drives.

They use the scenes, drives and golden sets of the tests, and no package of the product may import
them.
"""
