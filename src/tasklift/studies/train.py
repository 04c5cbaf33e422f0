"""Training on a user's own building: the best policy there is, certified; or the word that none is ready, and why."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tasklift import style
from tasklift.building.least import least_steps
from tasklift.building.mission import Mission
from tasklift.building.reading import PRESETS
from tasklift.checks import number, one_of
from tasklift.errors import TaskliftError
from tasklift.files import output_folder
from tasklift.lab import FILE_NAME, Progress, Store, run
from tasklift.lab.runs import export
from tasklift.learning.chances import CHOICE_STAGE
from tasklift.learning.reinforcement import Fixed, Reinforcement
from tasklift.plans.read import load_building
from tasklift.report import pictures
from tasklift.report.page import Link, Number, Report
from tasklift.studies import report
from tasklift.studies.arms import PRACTICE, Arm
from tasklift.studies.certify import Certified, certify, quantile_bound
from tasklift.studies.claims import indirect
from tasklift.studies.mission_file import declared, save_declared
from tasklift.studies.paper import figures
from tasklift.studies.readiness import advice, diagnose
from tasklift.studies.samples import Sample
from tasklift.studies.spec_file import arm_of
from tasklift.studies.study import Condition, Record, Study
from tasklift.tasks.policy import Policy

TRAINED = ("search", "expert", "direct", "copy", "copy-prior")
#: Fresh episodes on T by which the policies are compared, the same ones for all.
CHOICE_EPISODES = 500
#: Policies this close in the share solved, and in robots lost per episode, count as equally good.
TOLERANCE = 0.01


@dataclass(frozen=True, eq=False)
class Candidate:
    """A policy to hand over, and what it did in :data:`CHOICE_EPISODES` fresh episodes on T.

    Attributes
    ----------
    arm, seed
        Where it comes from.
    policy
        Outputs are drawn in proportion. One of an arm that is used greedily has only its heaviest outputs.
    solved, lost, steps
        Means per episode: the share solved, robots lost, steps.
    """

    arm: Arm
    seed: int
    policy: Policy
    solved: float
    lost: float
    steps: float

    def __str__(self) -> str:
        lost = f"loses {100 * self.lost:.1f} robots per 100 episodes"
        return f"solves {_percent(self.solved)}, {lost}, {self.steps:.0f} steps"


def train(
    *,
    building: Path,
    mission: Path | None = None,
    team: str | None = None,
    hostiles: int = 1,
    weapons_needed: int | None = None,
    limit: int | None = None,
    preset: str = "scattered",
    arms: Sequence[str] = TRAINED,
    curriculum: Sequence[Path] = (),
    seeds: int = 3,
    trials: int = 100,
    practice: int = PRACTICE,
    ready: float = 0.95,
    out: Path | None = None,
    command: str = "",
    progress: Progress | None = None,
    play: report.Play | None = None,
    **engine: Any,
) -> tuple[list[str], Path]:
    """Train arms on one building, and hand over the best policy if it is ready.

    Parameters
    ----------
    building
        File of the building.
    mission, team, weapons_needed, limit
        As in :func:`.declared`.
    hostiles
        As in :class:`tasklift.building.Mission`.
    preset
        ``scattered`` or ``cohesive``.
    arms
        Slugs; at least one that learns, or a curriculum.
    curriculum
        Spec files, whose curricula are further arms (:func:`tasklift.studies.spec_file.arm_of`).
    seeds, trials
        How many; trials on T, for arms that do not say otherwise.
    practice
        Episodes of drills for the arm that searches.
    ready
        The share of episodes that a policy must solve to be handed over, above 0.
    out
        Folder; default ``runs/`` and the building's file name.
    command
        The line that runs this again, for the report.
    progress, engine
        As in :func:`tasklift.lab.run`; also its ``workers`` and ``address``.
    play
        Writes replays beside the report, which its tables link to; None: there are none.

    Returns
    -------
    (list of str, Path)
        The result in a few lines, the most important one first; and the path of ``report.html``.

    Raises
    ------
    TaskliftError
        Before anything is trained or overwritten.
    """
    since = time.monotonic()
    place = load_building(building)
    rules = PRESETS[one_of(preset, list(PRESETS), "preset")]
    number(ready, "ready", 0.0, 1.0, above=True)
    named: list[str | Arm] = [*arms, *(arm_of(file) for file in curriculum)]
    study = Study.every(
        {building.stem: place}, {preset: Condition(rules, hostiles=hostiles)}, named, seeds=seeds, trials=trials,
        practice=practice, record=Record(weights=True),
        **declared(mission, team=team, weapons_needed=weapons_needed, limit=limit),
    )  # fmt: skip
    arms = study.slugs(building.stem)
    if not any(study.arms[slug].learns for slug in arms):
        raise TaskliftError("arms: none of those named learns; add search, direct or copy-prior")
    usual = Path("runs") / building.stem
    folder = output_folder(usual if out is None else out, (FILE_NAME,), ("figures", "policies"))
    with Store.open(folder / FILE_NAME, study.spec(f"training on {building.name}")) as store:
        run(store, study.cells(), study.work, progress=progress, **engine)
        export(folder, folder / "rows.csv")
        samples = {slug: Sample.of(store, slug, reading=preset) for slug in arms}
        # hostiles stand somewhere else in every episode: nobody knows where they will be
        world = study.mission(preset, building.stem).with_reading(relocate=True)
        found = candidates(study, store, world)
        price = {slug: _price(study, preset, building.stem, slug) for slug in arms}
        place.save(folder / "building.json")
        save_declared(world, folder)
        _save_points(found, ready, folder / "policies")
        best = chosen(found)
        best, made = _handed_over(best, ready, folder, {"hostiles": (hostiles,), "preset": preset})
        if made is not None:
            lines = [headline(made, best, world, price[best.arm.slug])]
        else:
            lines = _not_ready(best, world, ready, folder, progress)
        lines += comparison(found, samples, price, best)
        path = folder / "report.html"
        links = _replays(found, world, folder, play)
        page = _report(world, samples, found, price, study.arms, ready, lines, preset, folder, links, made)
        report.add_settings(page, store, command, since)
        page.write(path)
    return lines, path


def _handed_over(
    best: Candidate, ready: float, folder: Path, asked: dict[str, Any]
) -> tuple[Candidate, Certified | None]:
    """Write the policy and its certificate, if it is ready; return them. The certificate has the last word."""
    if best.solved < ready:
        return best, None
    best.policy.save(folder / "policy.json")
    made = certify(
        folder / "policy.json", building=folder / "building.json", out=folder / "certificate.json", force=True, **asked
    )
    counts = made.counts
    if counts.solved >= ready * counts.episodes:
        return best, made
    n = counts.episodes
    return replace(best, solved=counts.solved / n, lost=counts.lost / n, steps=counts.steps / n), None


def _replays(found: Sequence[Candidate], mission: Mission, folder: Path, play: report.Play | None) -> dict[str, Link]:
    """Write a replay of the best policy of each arm in a fresh episode; return the links by slug."""
    links = {}
    for arm in {c.arm.slug: c.arm for c in found}.values() if play else ():
        assert play is not None
        best = chosen([c for c in found if c.arm is arm])
        trace = mission.simulator.trace(best.policy, stage=CHOICE_STAGE, reinforcement=Reinforcement(), learn=False)
        (folder / "replays").mkdir(exist_ok=True)
        play(f"{mission.building.name}: {arm.label}, a fresh episode", [(arm.label, trace)],
             folder / "replays" / f"{arm.slug}.html")  # fmt: skip
        links[arm.slug] = Link("▶ an episode", f"replays/{arm.slug}.html")
    return links


def _not_ready(best: Candidate, mission: Mission, ready: float, folder: Path, progress: Progress | None) -> list[str]:
    """Hand over nothing; return why, and what would help."""
    for stale in ("policy.json", "certificate.json"):
        (folder / stale).unlink(missing_ok=True)
    return [
        f"none is ready: the best policy ({best.arm.label}) {best}; ready means {_percent(ready)} solved",
        *diagnose(mission, best.policy),
        *advice(mission, ready, progress),
    ]


# ---------------------------------------------------------------- the choice


def candidates(study: Study, store: Store, mission: Mission) -> list[Candidate]:
    """Return what every arm that is not random ended with, for every seed, tried in the same fresh episodes."""
    kept = [
        (study.arms[cell["arm"]], int(cell["seed"]), result.attachments["weights"])
        for cell, result in store.select(attachments=True)
        if cell["arm"] != "random"
    ]
    tables = np.stack([weights if arm.mixed else _heaviest(weights) for arm, _, weights in kept])
    outcomes = mission.evaluate(tables, CHOICE_EPISODES, stage=CHOICE_STAGE)
    return [
        Candidate(
            arm, seed, Policy(mission.task, table, {"learned_by": arm.label, "arm": arm.slug, "seed": seed}),
            float(outcomes.success[k].mean()), float(outcomes.losses[k].mean()), float(outcomes.steps[k].mean()),
        )
        for k, ((arm, seed, _), table) in enumerate(zip(kept, tables, strict=True))
    ]  # fmt: skip


def _heaviest(weights: np.ndarray) -> np.ndarray:
    return (weights == weights.max(axis=1, keepdims=True)).astype(np.float64)


def chosen(found: Sequence[Candidate]) -> Candidate:
    """Return the best candidate: solved counts first, then robots lost, then steps; near ties go to the next."""
    most = max(c.solved for c in found)
    good = [c for c in found if c.solved >= most - TOLERANCE]
    least = min(c.lost for c in good)
    return min((c for c in good if c.lost <= least + TOLERANCE), key=lambda c: (c.steps, c.arm.slug, c.seed))


def frontier(found: Sequence[Candidate], ready: float) -> list[Candidate]:
    """Return the ready candidates than which none is both faster and safer, the fastest first."""
    points: list[Candidate] = []
    for c in sorted((c for c in found if c.solved >= ready), key=lambda c: (c.steps, c.lost)):
        if not points or c.lost < points[-1].lost:
            points.append(c)
    return points


def _save_points(found: Sequence[Candidate], ready: float, folder: Path) -> None:
    """Save the best policy of every arm, and the points of the frontier."""
    for arm in {c.arm.slug: c.arm for c in found}.values():
        chosen([c for c in found if c.arm is arm]).policy.save(folder / f"{arm.slug}.json")
    for k, point in enumerate(frontier(found, ready), start=1):
        point.policy.save(folder / f"frontier-{k}.json")


# ---------------------------------------------------------------- the words


@dataclass(frozen=True)
class Price:
    """Episodes from which an arm learns: safe ones (no hostiles, or harmless ones) and dangerous ones."""

    safe: int
    dangerous: int


def _price(study: Study, condition: str, building: str, slug: str) -> Price:
    stages = [
        (stage, stage.trials or stage.learner.trials(stage.task))  # type: ignore[attr-defined]
        for stage in study.curriculum(study.cell(condition, building, 0, slug)).stages
        if not isinstance(stage.learner, Fixed)
    ]
    hostiles = [stage.world.n_hostiles for stage, _ in stages]  # type: ignore[union-attr]
    safe = sum(n for (stage, n), here in zip(stages, hostiles, strict=True) if stage.rehearsal or not here)
    return Price(safe, sum(n for _, n in stages) - safe)


def headline(certificate: Certified, best: Candidate, mission: Mission, price: Price) -> str:
    """Say what the policy that is handed over does, how sure that is, and what it cost."""
    counts, bounds = certificate.counts, certificate.bounds
    n, least = counts.episodes, least_steps(mission)
    return (
        f"ready: policy.json solves {_percent(counts.solved / n)} of episodes (at least "
        f"{_percent(bounds.solved_at_least)}) and loses {100 * counts.lost / n:.2f} robots per 100 episodes (at most "
        f"{bounds.lost_per_100_at_most:.2f}; both {100 * certificate.confidence:g} % sure), in {counts.steps / n:.0f} "
        f"steps ({counts.steps / n / least:.1f} times the least possible, {least}); made by {best.arm.label} from "
        f"{price.safe:,} safe and {price.dangerous:,} dangerous episodes"
    )


def comparison(
    found: Sequence[Candidate], samples: Mapping[str, Sample], price: Mapping[str, Price], best: Candidate
) -> list[str]:
    """Say in one line each what the other arms came to, and what their learning cost."""
    lines = []
    for slug, sample in samples.items():
        mine = [c for c in found if c.arm.slug == slug]
        if not mine or slug == best.arm.slug:
            continue
        arm, cost = mine[0].arm, ""
        if arm.learns:
            cost = f"; it learned from {price[slug].safe:,} safe and {price[slug].dangerous:,} dangerous episodes"
        if price[slug].dangerous:
            lost = sample.losses.sum(axis=1)
            cost += f", which cost {lost.mean():.0f} robots"
            if (bound := quantile_bound(lost)) is not None:
                cost += f" (95 % of runs lose at most {bound:.0f}, 95 % sure)"
        lines.append(f"{arm.label}: its best policy {chosen(mine)}{cost}")
    return lines


def _percent(share: float) -> str:
    return f"{np.floor(1000 * share + 1e-9) / 10:g} %"


# ---------------------------------------------------------------- the report


@pictures.styled
def frontier_figure(found: Sequence[Candidate], ready: float) -> Any:
    """Draw steps against robots lost of all candidates, and the frontier of the ready ones."""
    figure = pictures.page(6.0, 3.6)
    axes = figure.subplots()
    for arm in {c.arm.slug: c.arm for c in found}.values():
        mine = [c for c in found if c.arm is arm]
        axes.scatter(
            [c.steps for c in mine], [100 * c.lost for c in mine], s=[18 + 60 * c.solved for c in mine],
            color=style.look(arm.slug).line["color"], label=arm.label, alpha=0.8,
        )  # fmt: skip
    points = frontier(found, ready)
    axes.step([c.steps for c in points], [100 * c.lost for c in points], where="post", color="0.4", zorder=0)
    for k, point in enumerate(points, start=1):
        at = (point.steps, 100 * point.lost)
        axes.annotate(f"frontier-{k}", at, xytext=(4, 4), textcoords="offset points", size=7)
    axes.set_xlabel("steps per episode")
    axes.set_ylabel("robots lost per 100 episodes")
    axes.set_yscale("symlog", linthresh=1.0)
    axes.set_ylim(bottom=-0.1)
    axes.legend(fontsize=7)
    return figure


def numbers(best: Candidate, certificate: Certified | None, mission: Mission) -> list[Number]:
    """Return the headline's numbers: the share solved, robots lost, steps."""
    taken = best.steps if certificate is None else certificate.counts.steps / certificate.counts.episodes
    steps = Number(f"{taken:.0f}", "", f"steps per episode; at least {least_steps(mission)} are needed")
    if certificate is None:
        return [Number(_percent(best.solved), "", f"of {CHOICE_EPISODES} fresh episodes solved, by the best policy"),
                Number(f"{100 * best.lost:.1f}", "", "robots lost per 100 episodes"), steps]  # fmt: skip
    counts, bounds = certificate.counts, certificate.bounds
    sure = f"{100 * certificate.confidence:g} % sure"
    return [
        Number(_percent(counts.solved / counts.episodes), f"at least {_percent(bounds.solved_at_least)}",
               f"of {counts.episodes:,} fresh episodes solved ({sure})"),
        Number(f"{100 * counts.lost / counts.episodes:.2f}", f"at most {bounds.lost_per_100_at_most:.2f}",
               f"robots lost per 100 episodes ({sure})"),
        steps,
    ]  # fmt: skip


def _report(
    mission: Mission,
    samples: Mapping[str, Sample],
    found: Sequence[Candidate],
    price: Mapping[str, Price],
    arms: Mapping[str, Arm],
    ready: float,
    lines: Sequence[str],
    preset: str,
    folder: Path,
    links: Mapping[str, Link],
    certificate: Certified | None,
) -> Report:
    page, best = Report(f"Training on {mission.building.name}"), chosen(found)
    cost = price[best.arm.slug]
    says = (f"`policy.json` is ready: {best.arm.label} made it from {cost.safe:,} safe and {cost.dangerous:,} "
            "dangerous episodes.")  # fmt: skip
    page.headline(says if certificate else f"No policy is ready: {_percent(ready)} of episodes must be solved.",
                  numbers(best, certificate, mission))  # fmt: skip
    _, picture = pictures.save(frontier_figure(found, ready), folder / "figures", "frontier")
    page.figure(picture, "Speed against safety: every policy learned, larger where it solves more. Each point of the "
                "frontier is a file in `policies/`.")  # fmt: skip
    if certificate is None:
        page.verdict(*lines)
    page.section("Methods")
    slugs = dict.fromkeys(c.arm.slug for c in found)
    best_of = {slug: chosen([c for c in found if c.arm.slug == slug]) for slug in slugs}
    least = least_steps(mission)
    headers = ["method", "solved (%)", "robots lost per 100", "steps", "times the least", "safe episodes",
               "dangerous episodes", "play"]  # fmt: skip
    page.table(headers, [[*_row(c, price, least), links.get(slug)] for slug, c in best_of.items()],
               caption=f"The best policy of each method in {CHOICE_EPISODES} fresh episodes, hostiles placed afresh. "
               f"No policy can take fewer than {least} steps")  # fmt: skip
    with page.fold("What learning cost, in words"):
        page.bullets(lines)
    with page.fold("Every policy, by seed"):
        rows = [[c.arm.label, c.seed, *_row(c, price, least)[1:]] for c in found]
        page.table(["method", "seed", *headers[1:-1]], rows)
    report.add_arms(page, samples, arms)
    page.section("While they learned on the dangerous task T")
    report.add_curves(page, samples, preset, arms, ("steps", "robots_left"))
    with page.fold("Means while learning, and what was spent and lost by stage"):
        page.table(*report.arm_table(samples, arms), caption=f"On T, preset **{preset}**")
        page.table(report.LEDGER_HEADERS, report.ledger_rows(samples, arms), caption="Per seed")
    if all(sample.move_weights is not None for sample in samples.values()):
        with page.fold("Stop or move, by the feature faced"):
            for arm in indirect(samples, arms):
                report.add_move_weights(page, samples[arm], arms[arm].label)
    with page.fold("The building as a plan and as its graph"):
        page.figure(pictures.save(figures.figure1(mission.building), folder / "figures", "building")[1])
    return page


def _row(c: Candidate, price: Mapping[str, Price], least: int) -> list[Any]:
    cost, steps = price[c.arm.slug], round(c.steps)
    measured = [round(100 * c.solved, 1), round(100 * c.lost, 1), steps, round(c.steps / least, 1)]
    return [c.arm.label, *measured, cost.safe, cost.dangerous]
