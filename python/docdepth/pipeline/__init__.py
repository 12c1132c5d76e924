"""The stages of a run, one after the other: each reads what the one before wrote.

Every stage can be killed and goes on where it stopped; what is done is known from the files.
"""

from docdepth.concurrency import Progress
from docdepth.pipeline.classify import run_classify
from docdepth.pipeline.odometry import run_odometry
from docdepth.pipeline.render import run_render

__all__ = ["Progress", "run_classify", "run_odometry", "run_render"]
