"""The paper's experiment: its arms, its claims C1 to C12, its Figures 1 to 5 (Singh & Adams, ICRA 2006)."""
