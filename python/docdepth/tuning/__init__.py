"""Parameter search: classify one run with many parameter sets and compare each with the truth.

Each parameter set is a trial. A trial runs the classification stage of :mod:`docdepth.pipeline` in
a folder of its own and reads the deskewed sweeps of the run. Trials can run in parallel processes.
Results are kept on disk, so an interrupted search resumes where it stopped.
"""

from docdepth.tuning.results import Outcome, as_csv, plot, table
from docdepth.tuning.trials import Trial, grid, parse_axes, read_trials
from docdepth.tuning.tune import tune

__all__ = [
    "Outcome",
    "Trial",
    "as_csv",
    "grid",
    "parse_axes",
    "plot",
    "read_trials",
    "table",
    "tune",
]
