"""Doors to other people's environments, and from ours to other people's learners."""
