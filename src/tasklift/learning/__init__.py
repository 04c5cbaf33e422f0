"""How it is learned: worlds, learners, curricula of stages, and the comparison with learning from scratch."""
