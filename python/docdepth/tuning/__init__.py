"""Parameter search: make runs again with many parameter sets and judge each.

Each parameter set is a trial. A trial is a run folder of its own: it shares the files of the run,
and makes again the stages that its parameters change. What judges it are true labels, true depth
maps or sweeps that were left out. Trials can run in parallel processes. Results are kept on disk,
so an interrupted search resumes where it stopped.
"""

from docdepth.tuning.judges import DepthJudge, HeldOutJudge, Judge, LabelJudge
from docdepth.tuning.results import Outcome, as_csv, means, plot, table
from docdepth.tuning.trials import Trial, grid, parse_axes, read_trials
from docdepth.tuning.tune import mean_view, tune, tune_runs

__all__ = [
    "DepthJudge",
    "HeldOutJudge",
    "Judge",
    "LabelJudge",
    "Outcome",
    "Trial",
    "as_csv",
    "grid",
    "mean_view",
    "means",
    "parse_axes",
    "plot",
    "read_trials",
    "table",
    "tune",
    "tune_runs",
]
