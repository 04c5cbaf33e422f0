"""The world: a multi-robot search of a building that nobody has mapped (paper, section IV).

The kernel and what needs it are imported when they are first used.
"""

from tasklift.building.generate import generate
from tasklift.building.graph import Building
from tasklift.building.mission import Mission
from tasklift.building.missions import Missions
from tasklift.building.reading import COHESIVE, SCATTERED, Reading
from tasklift.building.team import SCOUT, WEAPON, Kind

__all__ = ["COHESIVE", "SCATTERED", "SCOUT", "WEAPON", "Building", "Kind", "Mission", "Missions", "Reading", "generate"]
