"""Checks that an extension keeps its promises, for its own tests. What is broken is an ``AssertionError``."""

from tasklift.testing.learning import check_learner, check_world
from tasklift.testing.readers import check_reader, damage

__all__ = ["check_learner", "check_reader", "check_world", "damage"]
