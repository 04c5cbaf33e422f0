"""A building of one's own, from Python: two rooms, a door between them: ``python own_building.py``."""

import tasklift as tl

document = {
    "format": "tasklift-building",
    "version": 1,
    "name": "three rooms",
    "start": 0,
    "nodes": [
        {"id": 0, "kind": "room", "x": 0, "y": 0, "area_m2": 12, "obstacles": 1},
        {"id": 1, "kind": "intersection", "x": 6, "y": 0},
        {"id": 2, "kind": "room", "x": 6, "y": -8, "area_m2": 24, "obstacles": 0},
        {"id": 3, "kind": "feature", "class": "door", "x": 10, "y": 0},
        {"id": 4, "kind": "room", "x": 16, "y": 0, "area_m2": 20, "obstacles": 0},
    ],
    "edges": [
        {"a": a, "b": b, "length_m": length, "width_m": 1.4}
        for a, b, length in [(0, 1, 6), (1, 2, 8), (1, 3, 4), (3, 4, 6)]
    ],
    "provenance": {},
}
building = tl.Building.from_json(document)
building.plot().savefig("building.png")

hunt = tl.Mission(building, team={"scout": 2, "weapon": 2}, hostiles=1)
curve = tl.reinforce(hunt, tl.Policy.equal(hunt.task), trials=200, seed=0)
print(building)
print(curve)
