"""Benchmarks: measurements of speed and of drives, which pytest does not collect.

They lie below tests because they use its scenes, drives and golden sets, which no package of the
product may import.
"""
