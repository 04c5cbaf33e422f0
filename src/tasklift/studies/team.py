"""Which team is needed: sizes of teams against what the best policy found for each does."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tasklift.building.least import least_steps
from tasklift.building.mission import Mission
from tasklift.building.reading import PRESETS
from tasklift.building.team import Kind, parse_team, team_to_json
from tasklift.building.terms import terms_to_json
from tasklift.checks import number, one_of, whole_number
from tasklift.errors import TaskliftError
from tasklift.files import output_folder
from tasklift.lab import FILE_NAME, Cell, CellResult, Progress, Spec, Store, run
from tasklift.learning.chances import CHOICE_STAGE
from tasklift.learning.curriculum import Curriculum
from tasklift.learning.learner import MOST_TRIALS
from tasklift.plans.read import load_building
from tasklift.report.charts import Mark, Row
from tasklift.report.page import Report
from tasklift.studies import report
from tasklift.studies.arms import Setup, expert, searching
from tasklift.studies.mission_file import declared

#: Episodes of practice per team, and fresh episodes by which a team's policies are judged.
PRACTICE, JUDGED = 12_000, 500
MOST_TEAMS = 400


def team(
    *,
    building: Path,
    mission: Path | None = None,
    scouts: Sequence[int] = (10,),
    weapons: Sequence[int] = (2, 3, 5, 8, 12, 18),
    hostiles: int = 1,
    weapons_needed: int | None = None,
    limit: int | None = None,
    preset: str = "scattered",
    practice: int = PRACTICE,
    ready: float = 0.95,
    out: Path | None = None,
    command: str = "",
    progress: Progress | None = None,
    **engine: Any,
) -> tuple[list[str], Path]:
    """Search a policy for every size of team, and say which is the smallest that is ready.

    Parameters
    ----------
    building
        File of the building.
    scouts, weapons
        Numbers of scouts and of weapon robots; every combination is tried.
    mission, weapons_needed, limit
        As in :func:`.declared`. The file's team says which kinds of robots the scouts and the weapon robots are.
    hostiles
        As in :class:`tasklift.building.Mission`.
    preset
        ``scattered`` or ``cohesive``.
    practice
        Episodes of drills per team.
    ready
        The share of episodes that a team must solve.
    out
        Folder; default ``runs/``, the building's file name and ``-team``.
    command
        The line that runs this again, for the report.
    progress, engine
        As in :func:`tasklift.lab.run`; also its ``workers`` and ``address``.

    Returns
    -------
    (list of str, Path)
        The result in a few lines; and the path of ``report.html``.

    Raises
    ------
    TaskliftError
        Before anything is trained or overwritten.
    """
    since = time.monotonic()
    place = load_building(building)
    number(ready, "ready", 0.0, 1.0, above=True)
    whole_number(practice, "practice", 400, MOST_TRIALS)
    reading = replace(PRESETS[one_of(preset, list(PRESETS), "preset")], relocate=True)
    if len(scouts) * len(weapons) > MOST_TEAMS:
        raise TaskliftError(f"team: asks for {len(scouts) * len(weapons):,} teams; at most {MOST_TEAMS}")
    terms = declared(mission, weapons_needed=weapons_needed, limit=limit)
    scout, weapon = _kinds(parse_team(terms.pop("team")))
    m = terms.get("weapons_needed", 2)
    missions = {
        f"{s}+{w}": Mission(place, {scout: s, weapon: w}, hostiles, reading, **terms)
        for s in sorted(set(scouts))
        for w in sorted(set(weapons))
        if w >= m or not hostiles
    }
    if not missions:
        raise TaskliftError(f"weapons: a hostile needs {m} weapon robots; name a larger number")
    first = next(iter(missions.values()))
    expert(first)  # refuses a task in which the reference cannot wait
    shared = terms_to_json(first) | {"team": team_to_json({scout: 0, weapon: 0})}
    settings = {"building": place.content_id, "hostiles": hostiles, "mission": shared, "preset": preset,
                "practice": practice, "judged": JUDGED}  # fmt: skip
    spec = Spec.of(f"teams for {place.name}", settings, {"team": list(missions)}, over=("team",))
    usual = Path("runs") / f"{building.stem}-team"
    folder = output_folder(usual if out is None else out, (FILE_NAME,), ("figures",))

    def work(cell: Cell) -> CellResult:
        return CellResult({}, judged(missions[cell["team"]], practice), {})

    with Store.open(folder / FILE_NAME, spec) as store:
        run(store, [Cell(team=name) for name in missions], work, progress=progress, **engine)
        found = {cell["team"]: result.summary for cell, result in store.select() if cell["team"] in missions}
        rows = [
            [name, mission.n_robots, found[name]["by"], round(100 * found[name]["solved"], 1),
             round(found[name]["steps"]), round(100 * found[name]["lost"], 1), least_steps(mission)]
            for name, mission in missions.items()
        ]  # fmt: skip
        verdict = _verdict(rows, ready)
        page = Report(f"Teams for {place.name}")
        page.headline(f"{verdict[0].upper()}{verdict[1:]}.")
        tried = [Row(row[0], [Mark(row[3], slug=row[2])], f"{row[4]} steps, {row[5]} lost per 100") for row in rows]
        page.rows(tried, title="Episodes solved, by team (scouts+weapon robots)", label="%", within=(0, 100))
        page.table(HEADERS, rows, caption=f"{JUDGED} fresh episodes each, hostiles placed afresh")
        report.add_settings(page, store, command, since)
        page.write(folder / "report.html")
    return [*(_line(row) for row in [HEADERS, *rows]), verdict], folder / "report.html"


def _kinds(team: Mapping[Kind, int]) -> tuple[Kind, Kind]:
    """Return the kind of scouts and the kind of weapon robots."""
    unarmed, armed = ([kind for kind in team if kind.armed is carries] for carries in (False, True))
    if len(unarmed) != 1 or len(armed) != 1:
        names = ", ".join(kind.name for kind in team)
        raise TaskliftError(f"team: expected one kind of robots without weapons and one with, found {names}")
    return unarmed[0], armed[0]


HEADERS = ["team", "robots", "policy", "solved (%)", "steps", "lost per 100", "steps needed"]


def _line(row: Sequence[Any]) -> str:
    return "".join(f"{cell!s:>{width}}" for cell, width in zip(row, (8, 8, 8, 12, 7, 14, 14), strict=True))


def _verdict(rows: Sequence[Sequence[Any]], ready: float) -> str:
    """Name the smallest team that is ready, the faster one of two; or the one that solves the most."""
    enough = [row for row in rows if row[3] >= 100 * ready]
    if not enough:
        most = max(rows, key=lambda row: row[3])
        return f"no team is ready: {most[0]} solves the most, {most[3]} % of {JUDGED} fresh episodes"
    name, _, by, solved, steps, lost, _ = min(enough, key=lambda row: (row[1], row[4]))
    return (
        f"the smallest team that is ready: {name} solves {solved} % of {JUDGED} fresh episodes and loses {lost} robots "
        f"per 100, in {steps} steps (policy: {by})"
    )


def judged(mission: Mission, practice: int) -> dict[str, Any]:
    """Return what the better of two policies does with a team: searched in drills, or the hand-written reference.

    Parameters
    ----------
    mission : Mission
        The dangerous task, with this team.
    practice : int
        Episodes of drills.
    """
    drills = Curriculum(searching(Setup(mission, practice=practice)).stages[:-1], block=None)
    policies = {"search": drills.run(seed=0).policy.extend(mission.task), "expert": expert(mission)}
    outcomes = mission.evaluate(list(policies.values()), JUDGED, stage=CHOICE_STAGE)
    solved, lost, steps = (np.mean(getattr(outcomes, name), axis=1) for name in ("success", "losses", "steps"))
    best = int(np.lexsort((steps, lost, -np.round(solved, 2)))[0])
    figures = {"solved": float(solved[best]), "lost": float(lost[best]), "steps": float(steps[best])}
    return {"by": list(policies)[best]} | figures
