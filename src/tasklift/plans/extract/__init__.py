"""From the free floor of a plan to rooms, corridors and doors."""
