"""Parameter search: make runs again with many parameter sets and score each.

Each parameter set is a trial: a run folder that shares the files of the run and makes again what
its parameters change. Trials are scored by true labels, true depth maps or left-out sweeps.
"""

from docdepth.tuning.results import Outcome, means, plot, table
from docdepth.tuning.trials import Objective, Trial, grid, read_trials
from docdepth.tuning.tune import tune

__all__ = ["Objective", "Outcome", "Trial", "grid", "means", "plot", "read_trials", "table", "tune"]
