"""A world of one's own, without Gymnasium: ``own_learner.py`` learns in it."""

import tasklift as tl


class Ferry:
    """Three stretches of water; who sails a storm on the last one sinks, and begins again."""

    place, storm, sail = tl.Variable("place", range(3)), tl.Variable("storm", (0, 1)), tl.Variable("sail", (0, 1))
    task = tl.Task("ferry", inputs=(place, storm), outputs=(sail,))
    limit = 30

    def __init__(self, storms):
        self.storms = storms

    def look(self):
        self.stormy = int(self.rng.random() < self.storms)
        return self.task.input_index({"place": self.at, "storm": self.stormy})

    def start(self, rng):
        self.rng, self.at = rng, 0
        return self.look()

    def step(self, output):
        sunk = output == 1 and self.at == 2 and self.stormy == 1
        self.at = 0 if sunk else self.at + output
        if self.at == 3:
            return tl.Step(0, -1.0, ended=True, success=True)
        return tl.Step(self.look(), -1.0 - 20 * sunk, ended=False, lost=int(sunk))
