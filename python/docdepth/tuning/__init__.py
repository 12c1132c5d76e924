"""Many parameter sets over the classification of one run: figures, seconds, a table and plots.

Each set is a trial, made by the very stages of a run (:mod:`docdepth.pipeline`) in a folder of its
own that borrows the deskewed sweeps of the run. Trials run side by side in processes; what is done
is known from the files, so a sweep that was killed goes on where it stopped.
"""

from docdepth.tuning.results import Outcome, as_csv, plot, table
from docdepth.tuning.trials import Trial, grid, parse_axes, read_trials
from docdepth.tuning.tune import sweep

__all__ = [
    "Outcome",
    "Trial",
    "as_csv",
    "grid",
    "parse_axes",
    "plot",
    "read_trials",
    "sweep",
    "table",
]
