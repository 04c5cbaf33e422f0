"""A mission: a building to be searched by a team. A world that policies are trained on."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasklift.building.search import hostile_candidates
from tasklift.building.setting import Setting
from tasklift.errors import TaskliftError
from tasklift.learning.chances import GREEDY_STAGE
from tasklift.learning.reinforcement import Reinforcement
from tasklift.tasks.policy import Policy
from tasklift.tasks.task import Task
from tasklift.text import shown

if TYPE_CHECKING:
    from tasklift.building.outcomes import SearchOutcomes
    from tasklift.building.simulator import Simulator


class Mission(Setting):
    """A building, a team, hidden hostiles and the rules they live by. A world that policies are trained on.

    It implements :class:`tasklift.learning.worlds.Trials`.

    Parameters
    ----------
    building : Building
        Where.
    team : str or mapping
        ``"10+5"`` (scouts + weapon robots), or how many robots of each :class:`Kind`, as
        :func:`~tasklift.building.team.parse_team` takes it. Robots are numbered in this order.
    hostiles : int or sequence of int
        How many, hidden at random at doors that are not next to the start (rule 14). Or the nodes of the
        features that they stand at.
    reading : Reading
        The world's rules.
    weapons_needed : int
        The paper's m: the number of weapon robots that destroy a hostile (at least 1).
    limit : int
        Steps after which an episode (trial) has failed (at least 1).
    inputs : sequence of str or Sensor
        The task's inputs: names of :data:`~tasklift.building.variables.INPUTS`, or sensors of your own. The default is
        the paper's (Table I). The first use of another selection compiles it, once per machine.
    outputs : sequence of str
        The task's outputs: names of :data:`~tasklift.building.variables.OUTPUTS`, the paper's three among them.

    Raises
    ------
    TaskliftError
        If there is no robot, if no team could ever destroy a hostile, or if there is no place to hide them.

    Examples
    --------
    >>> from tasklift.building import generate
    >>> hunt = Mission(generate(seed=7), team="10+5", hostiles=1)
    >>> hunt.n_robots, hunt.task.shape
    (15, (90, 44))
    >>> hunt.without_hostiles().n_hostiles
    0
    >>> from tasklift.building.variables import TABLE_I, TABLE_I_OUTPUTS
    >>> patient = Mission(hunt.building, "10+5", inputs=[*TABLE_I, "WAITED"], outputs=[*TABLE_I_OUTPUTS, "BACK"])
    >>> patient.task.shape
    (270, 88)
    """

    def without_hostiles(self) -> Mission:
        """Return the safe version: the same building and team, nothing hidden, hence nothing to suspect."""
        return dataclasses.replace(self, hostiles=0)

    def drill(self) -> Mission:
        """Return practice: a hostile at every place where one may hide, which repels instead of destroying."""
        places = tuple(hostile_candidates(self.building))
        return dataclasses.replace(self, hostiles=places).with_reading(drill=True)

    def with_reading(self, **options: Any) -> Mission:
        """Return the same mission under a reading with some options changed."""
        return dataclasses.replace(self, reading=dataclasses.replace(self.reading, **options))

    @cached_property
    def simulator(self) -> Simulator:
        """The compiled world of this mission."""
        from tasklift.building.simulator import Simulator

        return Simulator(self)

    @property
    def run(self) -> Callable[..., SearchOutcomes]:
        """Run trials, as :class:`~tasklift.learning.worlds.Trials` asks: :meth:`Simulator.run`."""
        return self.simulator.run

    @property
    def run_many(self) -> Callable[..., SearchOutcomes]:
        """Run trials of many policies in one compiled call: :meth:`Simulator.run_many`."""
        return self.simulator.run_many

    def evaluate(
        self,
        policies: Policy | Sequence[Policy] | NDArray[np.float64],
        episodes: int,
        seed: int = 0,
        *,
        reinforcement: Reinforcement | None = None,
        stage: int = GREEDY_STAGE,
        first_episode: int = 0,
        threads: int | None = None,
    ) -> SearchOutcomes:
        """Play many policies without learning, in one compiled call over all cores.

        All policies play the same episodes (trials) with the same random numbers, so their outcomes are paired. A
        policy's outcomes do not depend on the other policies, on the number of threads, or on how calls are cut.

        Parameters
        ----------
        policies : Policy, sequence of Policy, or float64 (P, S, A)
            Policies of one task: the mission's own, or a simplification of it. An array is of the mission's task.
        episodes : int
            Episodes per policy.
        seed, stage, first_episode : int
            The random key. The stage keeps these episodes apart from those of training.
        reinforcement : Reinforcement, optional
            Its ``selection`` and ``q`` say how outputs are chosen from weights; by default they are drawn.
        threads : int, optional
            Number of threads; all cores by default.

        Returns
        -------
        SearchOutcomes
            Arrays ``(P, episodes)``.

        Raises
        ------
        TaskliftError
            For policies of different tasks or of another world, tables that are not finite numbers of at least 0, and
            numbers out of range; and if the world shows an input that the task leaves out.

        Examples
        --------
        >>> import tasklift as tl
        >>> from tasklift.building import generate
        >>> hunt = Mission(generate(seed=7), team="10+5")
        >>> hunt.evaluate([tl.Policy.equal(hunt.task)] * 2, episodes=4).steps.shape
        (2, 4)
        """
        if isinstance(policies, np.ndarray):
            task, weights = self.task, np.require(policies, requirements=["C", "A", "W"])
        else:
            task, weights = _tables([policies] if isinstance(policies, Policy) else policies)
        return self.simulator.run_many(
            task,
            weights,
            trials=episodes,
            seeds=[seed] * (len(weights) if weights.ndim else 0),
            stage=stage,
            reinforcement=Reinforcement() if reinforcement is None else reinforcement,
            first_trial=first_episode,
            learn=False,
            threads=threads,
        )


def _tables(policies: Sequence[Policy]) -> tuple[Task, NDArray[np.float64]]:
    """Return the one task of some policies, and their weights, float64 (P, S, A)."""
    if not isinstance(policies, list | tuple):
        raise TaskliftError(f"evaluate: expected policies, or an array (P, S, A), found {shown(policies)}")
    for policy in policies:
        if not isinstance(policy, Policy):
            raise TaskliftError(f"evaluate: expected policies, or an array (P, S, A), found {shown(policy)}")
        if policy.task != policies[0].task:
            raise TaskliftError(
                f"evaluate: expected policies of one task, found {policies[0].task.name!r} and {policy.task.name!r}"
            )
    if not len(policies):
        raise TaskliftError("evaluate: expected at least one policy, found none")
    return policies[0].task, np.stack([policy.weights for policy in policies])
