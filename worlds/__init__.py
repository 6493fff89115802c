"""Worlds: reading, generating, measuring and drawing the courses that robots drive."""
