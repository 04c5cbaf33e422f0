# The names that __init__.py finds on first use, for type checkers; a test compares the two.
from tasklift.building.generate import generate as generate
from tasklift.building.graph import Building as Building
from tasklift.building.mission import Mission as Mission
from tasklift.building.missions import Missions as Missions
from tasklift.building.reading import COHESIVE as COHESIVE
from tasklift.building.reading import SCATTERED as SCATTERED
from tasklift.building.reading import Reading as Reading
from tasklift.building.team import SCOUT as SCOUT
from tasklift.building.team import WEAPON as WEAPON
from tasklift.building.team import Kind as Kind
from tasklift.envs.ids import make as make
from tasklift.errors import TaskliftError as TaskliftError
from tasklift.learning.approx import (
    approximate as approximate,
)
from tasklift.learning.approx import (
    fidelity as fidelity,
)
from tasklift.learning.approx import (
    learn_approximate as learn_approximate,
)
from tasklift.learning.chances import Chances as Chances
from tasklift.learning.compare import compare as compare
from tasklift.learning.curriculum import Curriculum as Curriculum
from tasklift.learning.guard import Guard as Guard
from tasklift.learning.guard import Watch as Watch
from tasklift.learning.learner import Curve as Curve
from tasklift.learning.learner import InTurn as InTurn
from tasklift.learning.learner import Learner as Learner
from tasklift.learning.learner import Run as Run
from tasklift.learning.ledger import Ledger as Ledger
from tasklift.learning.model import Model as Model
from tasklift.learning.reinforcement import (
    Fixed as Fixed,
)
from tasklift.learning.reinforcement import (
    Reinforcement as Reinforcement,
)
from tasklift.learning.reinforcement import (
    StepTrials as StepTrials,
)
from tasklift.learning.reinforcement import (
    Sweep as Sweep,
)
from tasklift.learning.reinforcement import (
    reinforce as reinforce,
)
from tasklift.learning.reinforcement import (
    sweep as sweep,
)
from tasklift.learning.search import PolicySearch as PolicySearch
from tasklift.learning.stage import Stage as Stage
from tasklift.learning.values import (
    ValueLearning as ValueLearning,
)
from tasklift.learning.values import (
    evaluate as evaluate,
)
from tasklift.learning.values import (
    learn_values as learn_values,
)
from tasklift.learning.worlds import (
    Outcomes as Outcomes,
)
from tasklift.learning.worlds import (
    Step as Step,
)
from tasklift.learning.worlds import (
    StepOutcomes as StepOutcomes,
)
from tasklift.learning.worlds import (
    Steps as Steps,
)
from tasklift.learning.worlds import (
    Trials as Trials,
)
from tasklift.learning.worlds import (
    joined as joined,
)
from tasklift.networks.extend import extend_module as extend_module
from tasklift.tasks.policy import (
    Policy as Policy,
)
from tasklift.tasks.policy import (
    forget as forget,
)
from tasklift.tasks.policy import (
    invert as invert,
)
from tasklift.tasks.policy import (
    scale as scale,
)
from tasklift.tasks.policy import (
    set_weight as set_weight,
)
from tasklift.tasks.policy import (
    swap as swap,
)
from tasklift.tasks.task import Signal as Signal
from tasklift.tasks.task import Task as Task
from tasklift.tasks.task import Variable as Variable

__version__: str
