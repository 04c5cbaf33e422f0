"""The multiverse of readings: how far the claims depend on what the paper leaves open."""
