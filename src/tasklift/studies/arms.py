"""Arms: what is compared. An arm is a slug, a label and a curriculum.

:data:`ARMS` has all of them. A further one is an entry there (or an :class:`Arm` of your own, handed to a
:class:`~tasklift.studies.study.Study`): it is then trained, judged against the arms that it names, drawn and listed.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, MutableMapping
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import partial
from typing import Any, Literal

import numpy as np

from tasklift.building.mission import Mission
from tasklift.building.search import ENEMY_FEATURE, hostile_candidates, search_only
from tasklift.errors import TaskliftError
from tasklift.learning.chances import BUDGET_STAGE, DRILL_STAGE, FULL_DRILL_STAGE, SWEEP_STAGE, TARGET_STAGE
from tasklift.learning.curriculum import Curriculum
from tasklift.learning.learner import InTurn
from tasklift.learning.reinforcement import Fixed, Reinforcement, Sweep
from tasklift.learning.search import PolicySearch
from tasklift.learning.stage import Stage
from tasklift.tasks.policy import Policy, forget, set_weight, swap
from tasklift.tasks.prior import Prior

#: Where a hostile may wait and the team is too weak for it: the unsafe rows that prior knowledge is about.
UNSAFE = {"FTR": ENEMY_FEATURE, "nWPN": (0, 1)}
#: "if we know that the unsafe value requires the direct opposite of the safe value actions" (section VII)
PRIOR = (swap("MV", when=UNSAFE),)
#: The signal of a loss in the arms that have one (rule 21).
LOSS_SIGNAL = -0.5
#: Trials before those on T that count, in the arms that are compared at equal totals.
SPENT_BEFORE = 300
#: What V costs: 44 outputs × 5 traversals.
TRAVERSALS = 220
#: Episodes of practice in which the search looks for a policy.
PRACTICE = 36_000
#: Trials on T that count for every arm of the drill study: its last ones.
COUNTED = 100


@dataclass(frozen=True, eq=False)
class Setup:
    """What an arm's curriculum is made for.

    Attributes
    ----------
    mission
        T's world.
    reinforcement
        The learner's settings, which an arm may change.
    trials
        On the full task T.
    repeats
        Traversals per output on the simple task V.
    practice
        Episodes of practice with harmless hostiles (drills) for the arm that searches.
    worlds
        The worlds made so far. Setups that share this mapping share their worlds, and arms that share a world share
        what they learn in it first (:meth:`.Curriculum.run`).
    """

    mission: Mission
    reinforcement: Reinforcement = field(default_factory=Reinforcement)
    trials: int = 100
    repeats: int = 5
    practice: int = PRACTICE
    worlds: MutableMapping[Any, Mission] = field(default_factory=dict)

    def world(self, hostiles: int | tuple[int, ...] | None = None, **reading: Any) -> Mission:
        """Return the mission with other hostiles, or other rules; always the same object for the same ones."""
        mission = self.mission
        changed = replace(mission, hostiles=mission.hostiles if hostiles is None else hostiles)
        changed = changed.with_reading(**reading) if reading else changed
        return self.worlds.setdefault((changed.hostiles, changed.reading), changed)


@dataclass(frozen=True)
class Arm:
    """One way to come to the full task T.

    Attributes
    ----------
    slug
        ``[a-z0-9-]+``: in stores, options and file names.
    label
        For people.
    meaning
        One line for readers.
    curriculum
        Makes the curriculum for a :class:`Setup`. Its stage on T is named ``target``.
    against
        Slugs of the arms that the claims compare it with: direct learning, and the control that isolates its cause.
    exploiting
        Slug of the same arm with the rule *exploitation*, for the claim that compares the two (C10).
    learns
        False: a reference that never changes.
    drawn
        Whether figures show it; where none of the arms is to be drawn, all are.
    rows
        False: of its trials only what is summed up is stored.
    unspent
        Stages that are not booked: prior knowledge is made from them, the arm does not pay for them.
    settings
        What decides the arm beside its slug, as JSON; for arms that are not of this package.
    mixed
        Whether the policy is used as it is, outputs drawn in proportion; otherwise always by the heaviest output.
    """

    slug: str
    label: str
    meaning: str
    curriculum: Callable[[Setup], Curriculum]
    against: tuple[str, ...] = ()
    exploiting: str | None = None
    learns: bool = True
    drawn: bool = False
    rows: bool = True
    unspent: tuple[str, ...] = ()
    settings: Any = None
    mixed: bool = False

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", self.slug):
            raise TaskliftError(f"arm {self.slug!r}: expected a slug of a-z, 0-9 and -, such as copy-prior")


# ---------------------------------------------------------------- stages


@dataclass(frozen=True)
class Drilling:
    """Practice trials with harmless hostiles (drills): they repel instead of destroying (rule 21).

    Attributes
    ----------
    trials
        How many drills.
    loss_signal
        At every would-be loss; on T it is always :data:`LOSS_SIGNAL`.
    credit
        As in :class:`.Reinforcement`.
    q
        Probability of the heaviest output, in equal parts of the drills one after another; 0 is exploration.
    hostiles
        ``same``: where they will be on T; ``relocated``: as many, placed afresh in every drill; ``every door``: one
        at each door that may hide one. Only the first needs to know where the hostiles are.
    """

    trials: int = SPENT_BEFORE
    loss_signal: float = LOSS_SIGNAL
    credit: Literal["decision", "trial"] = "decision"
    q: tuple[float, ...] = (0.0,)
    hostiles: Literal["same", "relocated", "every door"] = "same"

    def stage(self, on: Setup, prior: Iterable[Prior] = ()) -> Stage:
        """Return the drills as a stage of a curriculum.

        Parameters
        ----------
        on
            What the curriculum is made for.
        prior
            Prior knowledge, applied to the policy with which the drills begin.
        """
        doors = tuple(hostile_candidates(on.mission.building)) if self.hostiles == "every door" else None
        relocate = self.hostiles == "relocated" or on.mission.reading.relocate
        rules = replace(on.reinforcement, loss_signal=self.loss_signal, credit=self.credit, selection="pseudo-random")
        learners = tuple(replace(rules, q=q) for q in self.q)
        starts = tuple(round(self.trials * i / len(self.q)) for i in range(len(self.q)))
        return Stage(
            "drill",
            on.mission.task,
            on.world(doors, drill=True, relocate=relocate),
            InTurn(learners, starts) if len(learners) > 1 else learners[0],
            trials=self.trials,
            prior=tuple(prior),
            rehearsal=True,
            key=DRILL_STAGE,
        )


def source_stage(on: Setup) -> Stage:
    """Return the simple task V: every output held for ``repeats`` trials on the mission without hostiles."""
    learner = Sweep(on.reinforcement, on.repeats)
    return Stage("source", search_only(on.mission.task), on.world(0), learner, key=SWEEP_STAGE)


def prior_alone(initial_weight: float) -> tuple[Prior, ...]:
    """Return the priors that leave of V only what :data:`PRIOR` says at :data:`UNSAFE` inputs; even weights else."""
    elsewhere = {"FTR": [ftr for ftr in range(1, 6) if ftr != ENEMY_FEATURE]}
    return (*PRIOR, set_weight(initial_weight, when=elsewhere), set_weight(initial_weight, when={"nWPN": 2}))


#: The family that the reference is the best of: CA, and how often a team with m weapon robots pauses where it faces no
#: feature, so that a team that stays together divides.
EXPERTS = tuple((ca, pause) for ca in (0.0, 0.5, 1.0) for pause in (0.0, 0.2, 0.5))
#: The best of them under the presets, chosen on six buildings (seeds 8000 to 8005) that are used for nothing else.
SCATTERED_EXPERT, COHESIVE_EXPERT = (0.0, 0.0), (0.0, 0.2)


def expert(mission: Mission, member: tuple[float, float] | None = None) -> Policy:
    """Return the hand-written reference: stop where a hostile may hide until m weapon robots are there, else move.

    Parameters
    ----------
    mission
        Whose hostiles and rules it minds.
    member
        Of :data:`EXPERTS`; default: the one chosen for these rules.
    """
    together = mission.reading.split == "team"
    ca, pause = member or (COHESIVE_EXPERT if together else SCATTERED_EXPERT)
    task, features = mission.task, mission.building.feature_class
    hides = sorted({int(features[node]) for node in hostile_candidates(mission.building)})
    stop = np.zeros((task.shape[0], 1))
    stop[task.input_mask({"FTR": 1, "nWPN": 2})] = pause
    if hides:
        stop[task.input_mask({"FTR": hides, "nWPN": (0, 1)})] = 1.0
    further = {variable.name: variable.values[0] for variable in task.outputs}
    ways = [task.where({**further, "MV": move, "CA": ca}) for move in (0, 1)]
    return Policy(task, stop * ways[0] + (1.0 - stop) * ways[1], {"made_by": "expert", "CA": ca, "pause": pause})


# ---------------------------------------------------------------- curricula


Start = Literal["equal", "copy", "prior", "copy-prior", "copy-forget"]


def to_target(
    on: Setup,
    start: Start = "equal",
    *,
    budget: int = 0,
    drilling: Drilling | None = None,
    trials: int | None = None,
    **rules: Any,
) -> Curriculum:
    """Return a curriculum that ends on T: V where the start asks for it, a budget or drills, then T.

    Parameters
    ----------
    on
        What it is made for.
    start
        What learning begins with. ``equal``: even weights. ``copy``: V's, copied. ``copy-prior``: then changed by
        :data:`PRIOR`. ``copy-forget``: then without what V taught about MV. ``prior``: even weights but where the prior
        speaks.
    budget
        Additional trials on T before those that count.
    drilling
        Drills before T.
    trials
        On T; default: the setup's.
    rules
        Fields of :class:`.Reinforcement` that this arm changes on T.

    Examples
    --------
    >>> from tasklift.building import Mission, generate
    >>> on = Setup(Mission(generate(seed=7), "10+5"))
    >>> [stage.name for stage in to_target(on, "copy", drilling=Drilling(80), loss_signal=-0.5).stages]
    ['source', 'drill', 'target']
    """
    task, learner = on.mission.task, replace(on.reinforcement, **rules)
    priors = {
        "copy-prior": PRIOR,
        "prior": prior_alone(on.reinforcement.initial_weight),
        "copy-forget": (forget("MV"),),
    }.get(start, ())
    stages = [] if start == "equal" else [source_stage(on)]
    if budget:
        stages.append(Stage("budget", task, on.world(), learner, trials=budget, prior=priors, key=BUDGET_STAGE))
        priors = ()
    if drilling is not None:
        stages.append(drilling.stage(on, priors))
        priors = ()
    stages.append(
        Stage("target", task, on.world(), learner, trials=trials or on.trials, prior=priors, key=TARGET_STAGE)
    )
    return Curriculum(stages, block=None)


def _direct_budget(on: Setup) -> Curriculum:
    return to_target(on, budget=on.repeats * on.mission.task.shape[1])


def _source_alone(on: Setup) -> Curriculum:
    return Curriculum([source_stage(on)], block=None)


def _random(on: Setup) -> Curriculum:
    return _never_learning(on, None)


def _expert(on: Setup) -> Curriculum:
    return _never_learning(on, expert(on.mission))


def _never_learning(on: Setup, policy: Policy | None) -> Curriculum:
    learner = Fixed(on.reinforcement)
    task, world = on.mission.task, on.world()
    stage = Stage("target", task, world, learner, trials=on.trials, initial=policy, key=TARGET_STAGE)
    return Curriculum([stage], block=None)


def searching(on: Setup) -> Curriculum:
    """Search in drills, first without the inputs DL and GL, then with them; T is played, nothing is tried there."""
    learner, task = PolicySearch(), on.mission.task
    drills = on.world(tuple(hostile_candidates(on.mission.building)), drill=True)
    generation = learner.population * learner.episodes
    late = on.practice // 3 // generation * generation
    told = [variable.name for variable in task.inputs if variable.name in ("DL", "GL")]
    stages = [Stage("drill", task.simplify(remove=told), drills, learner, trials=on.practice - late,
                    rehearsal=True, key=DRILL_STAGE)]  # fmt: skip
    if late:
        stages.append(Stage("full-drill", task, drills, learner, trials=late, trust=6.0, rehearsal=True,
                            key=FULL_DRILL_STAGE))  # fmt: skip
    played = Fixed(replace(on.reinforcement, selection="exploration"))
    stages.append(Stage("target", task, on.world(), played, trials=on.trials, key=TARGET_STAGE))
    return Curriculum(stages, block=None)


_OURS: dict[str, Any] = {"loss_signal": LOSS_SIGNAL, "selection": "pseudo-random"}
_EXPLOITATION: dict[str, Any] = {"selection": "exploitation"}

#: The arms of the paper's experiment.
PAPER: tuple[Arm, ...] = (
    Arm("random", "random", "every output equally likely, never learns", _random, learns=False),
    Arm("expert", "expert", "stops at doors until m weapon robots are there, else moves towards its goal; never "
        "learns", _expert, learns=False, drawn=True, mixed=True),
    Arm("direct", "direct", "learns T from equal weights", to_target, drawn=True),
    Arm("direct-budget", "direct+budget", "direct, with V's traversals spent as additional trials on T",
        _direct_budget),
    Arm("copy", "copy", "learns V, copies its weights, continues on T: the paper's indirect learning",
        partial(to_target, start="copy"), against=("direct", "direct-budget"), exploiting="copy-exploitation",
        drawn=True),
    Arm("prior", "prior", "equal weights, with the prior knowledge but without V", partial(to_target, start="prior"),
        drawn=True),
    Arm("copy-prior", "copy+prior", "copy, with stop and move swapped at doors for teams too weak",
        partial(to_target, start="copy-prior"), against=("direct", "prior"), exploiting="copy-prior-exploitation",
        drawn=True),
    Arm("copy-exploitation", "copy, exploitation", "copy, always taking the heaviest output (for C10)",
        partial(to_target, start="copy", **_EXPLOITATION)),
    Arm("copy-prior-exploitation", "copy+prior, exploitation", "copy+prior, always taking the heaviest output (for "
        "C10)", partial(to_target, start="copy-prior", **_EXPLOITATION)),
    Arm("direct-loss", "direct, loss signal", "direct, punished for every loss, at q = .9",
        partial(to_target, **_OURS)),
    Arm("direct-budget-loss", "direct+budget, loss signal", "the same with 300 additional trials on T before",
        partial(to_target, budget=SPENT_BEFORE, **_OURS)),
    Arm("drill", "drill", "300 drills (hostiles that repel), then T, with the loss signal, at q = .9",
        partial(to_target, drilling=Drilling(), **_OURS)),
    Arm("copy-drill", "V→drill", "V's 220 traversals, copied, then 80 drills, then T, with the loss signal, at q = .9",
        partial(to_target, start="copy", drilling=Drilling(SPENT_BEFORE - TRAVERSALS), **_OURS)),
)  # fmt: skip
#: V alone, for the survey of the coverage coefficient.
SOURCE = Arm("v", "V", "learns the simple task V and nothing else", _source_alone, rows=False)


# ---------------------------------------------------------------- the arms of the study of drills

#: The rules on T, by slug, with the words for them.
SELECTIONS = {"q90": "q = .9", "exploitation": "exploitation"}
_RULES: dict[str, dict[str, Any]] = {
    "q90": {"loss_signal": LOSS_SIGNAL, "selection": "pseudo-random", "q": 0.9},
    "exploitation": {"loss_signal": LOSS_SIGNAL, "selection": "exploitation"},
}
EVERY_DOOR = Drilling(hostiles="every door")
AMOUNTS = (100, 300, 1000)

_LATE = Drilling(SPENT_BEFORE - TRAVERSALS)
_TURNS = (0.0, 0.5, 0.9)
#: What might make drills better: one change each, then together. V's 220 traversals and 80 drills cost what 300 do.
#: They are tried on other maps than those reported.
VARIANTS: dict[str, tuple[str, Start, Drilling]] = {
    "as-it-is": ("as it is", "equal", Drilling()),
    "loss-1": ("loss signal -1", "equal", Drilling(loss_signal=-1.0)),
    "loss-1-5": ("loss signal -1.5", "equal", Drilling(loss_signal=-1.5)),
    "credit-once": ("credit once a trial", "equal", Drilling(credit="trial")),
    "q90": ("by q = .9", "equal", Drilling(q=(0.9,))),
    "q-in-turn": ("q = 0, .5, .9 in turn", "equal", Drilling(q=_TURNS)),
    "hostiles-relocated": ("hostiles relocated", "equal", Drilling(hostiles="relocated")),
    "every-door": ("every door", "equal", EVERY_DOOR),
    "every-door-loss-1-5": ("every door, loss signal -1.5", "equal", replace(EVERY_DOOR, loss_signal=-1.5)),
    "every-door-credit-once": ("every door, credit once a trial", "equal", replace(EVERY_DOOR, credit="trial")),
    "every-door-q90": ("every door, by q = .9", "equal", replace(EVERY_DOOR, q=(0.9,))),
    "every-door-q-in-turn": ("every door, q in turn", "equal", replace(EVERY_DOOR, q=_TURNS)),
    "v-then-80-drills": ("V, then 80 drills", "copy", _LATE),
    "v-then-80-every-door": ("V, then 80, every door", "copy", replace(_LATE, hostiles="every door")),
    "v-then-80-every-door-q-in-turn": (
        "V, then 80, every door, q in turn", "copy", replace(_LATE, hostiles="every door", q=_TURNS)
    ),
}  # fmt: skip

#: What drills follow on, beside equal weights: the start, its label, the number of drills, one line for readers.
STARTS: tuple[tuple[Start, str, int, str], ...] = (
    ("copy", "copy", 80, "V, copied, then 80 drills: as many trials as 300 drills"),
    ("copy", "copy", 300, "V, copied, then 300 drills"),
    ("copy-prior", "copy+prior", 80, "V, copied, stop and move swapped at doors, then 80 drills"),
    ("copy-prior", "copy+prior", 300, "V, copied, stop and move swapped at doors, then 300 drills"),
    ("prior", "prior", 300, "equal weights, the prior at doors, then 300 drills"),
)


def _drill_arms(selection: str) -> list[Arm]:
    """Return the arms of the study of drills with one rule on T."""
    words, rules = SELECTIONS[selection], _RULES[selection]
    arms = [
        Arm(f"direct-{trials}-{selection}", f"direct, {trials} trials, {words}", "equal weights, all trials on T",
            partial(to_target, trials=trials, **rules))
        for trials in (COUNTED + 300, COUNTED + 1000)
    ]  # fmt: skip

    def add(slug: str, label: str, meaning: str, start: Start, drilling: Drilling | None, against: int) -> None:
        arms.append(
            Arm(f"{slug}-{selection}", f"{label}, {words}", meaning,
                partial(to_target, start=start, drilling=drilling, trials=COUNTED, **rules),
                against=(f"direct-{COUNTED + against}-{selection}",),
                unspent=("source",) if start == "prior" else ())
        )  # fmt: skip

    for amount in AMOUNTS:
        against = 300 if amount == 300 else 1000
        add(f"drill-{amount}", f"drill {amount}", f"{amount} drills by exploration", "equal", Drilling(amount), against)
        add(f"every-door-{amount}", f"every-door drill {amount}",
            f"{amount} drills by exploration, with hostiles at every door", "equal",
            replace(EVERY_DOOR, trials=amount), against)  # fmt: skip
    for start, label, amount, meaning in STARTS:
        main = 300 if (start, amount) == ("copy", 80) else 1000
        add(f"{start}-drill-{amount}", f"{label}→drill {amount}", meaning, start, Drilling(amount), 1000)
        add(f"{start}-every-door-{amount}", f"{label}→every-door drill {amount}",
            f"{meaning}, with hostiles at every door", start, replace(EVERY_DOOR, trials=amount), main)  # fmt: skip
    for start, label in (("copy", "copy"), ("copy-prior", "copy+prior"), ("prior", "prior")):
        add(f"{start}-loss", label, f"{label}, no drills", start, None, 1000)
    return arms


#: The arms of the study of drills, and the variants of drilling that were tried.
DRILLS: tuple[Arm, ...] = (
    *(arm for selection in SELECTIONS for arm in _drill_arms(selection)),
    *(Arm(f"variant-{slug}", f"variant: {label}", f"drills: {label}",
          partial(to_target, start=start, drilling=drilling, trials=COUNTED, **_RULES["q90"]))
      for slug, (label, start, drilling) in VARIANTS.items()),
)  # fmt: skip

#: Extending V and forgetting on purpose what it cannot know: when to stop.
FORGET = Arm("copy-forget", "copy+forget", "copy, with what V taught about stopping spread evenly again",
             partial(to_target, start="copy-forget"), against=("direct", "direct-budget"), drawn=True)  # fmt: skip
#: What is ours, and handed over to users.
SEARCH = Arm("search", "policy search in drills", "searches whole policies in practice with a hostile at every door; "
             "meets the dangerous task with what it found", searching, drawn=True, mixed=True)  # fmt: skip
#: What the paper's policies are judged against as well: one search per map, of which only the policy is kept.
SEARCHED = replace(SEARCH, slug="searched", label="searched in drills", rows=False, drawn=False,
                   meaning="the policy that one search in drills finds on a map")  # fmt: skip
#: Every arm by its slug.
ARMS: dict[str, Arm] = {arm.slug: arm for arm in (*PAPER, SOURCE, FORGET, SEARCH, SEARCHED, *DRILLS)}


def arms_named(slugs: Iterable[str], known: Mapping[str, Arm] = ARMS) -> tuple[Arm, ...]:
    """Return the arms with these slugs, in this order.

    Parameters
    ----------
    slugs
        Names, each once.
    known
        All arms by slug.

    Raises
    ------
    TaskliftError
        For a slug that is unknown or there twice; names the nearest ones.
    """
    found = tuple(slugs)
    for slug in found:
        if slug not in known:
            near = get_close_matches(slug, known, n=3, cutoff=0.5) or list(known)[:13]
            raise TaskliftError(f"arm {slug!r} is unknown; the nearest are: {', '.join(near)}")
        if found.count(slug) > 1:
            raise TaskliftError(f"arm {slug!r} is named twice")
    return tuple(known[slug] for slug in found)
