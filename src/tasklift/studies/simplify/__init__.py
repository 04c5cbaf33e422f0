"""Which simpler task to learn first: the space of candidates, the search, its answer."""
