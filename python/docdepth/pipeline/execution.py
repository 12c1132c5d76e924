"""How a run is carried out: it changes neither labels nor depth."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from docdepth.concurrency import Progress
from docdepth.errors import ConfigError
from docdepth.io.inputs import Checked
from docdepth.io.manifest import Keep
from docdepth.pipeline.parallel import WorkerPool
from docdepth.render.backends import Renderer


def _renderer(renderer: Any) -> Any:
    return Renderer(renderer) if isinstance(renderer, str) else renderer or Renderer()


class Execution(Checked):
    """How a run is carried out: workers, memory, renderer, and what stays.

    Each field with a description is an option of ``docdepth run``. A script that asks for jobs
    needs the line ``if __name__ == "__main__":``.
    """

    model_config = ConfigDict(arbitrary_types_allowed=True)

    threads: int = Field(
        0,
        ge=0,
        le=256,
        description="Threads to use; 0 takes every core. Same result.",
        json_schema_extra={"metavar": "N"},
    )
    jobs: int = Field(
        1,
        ge=1,
        le=1024,
        description="Processes of this machine that share the work after odometry. Same result.",
        json_schema_extra={"metavar": "N"},
    )
    scheduler: str | None = Field(
        None,
        description="Dask scheduler (tcp://HOST:8786) whose workers share the work instead. They "
        "must see recording and run folder under the same paths.",
        json_schema_extra={"metavar": "ADDRESS"},
    )
    memory: str | None = Field(
        None,
        description="Most memory of all processes together, for example 4G: ground grows in chunks "
        "short enough, or the run says before it starts what it would need. Same result.",
        json_schema_extra={"metavar": "SIZE"},
    )
    renderer: Annotated[Renderer, BeforeValidator(_renderer)] = Field(
        Renderer(), description="What draws; all draw the same. cpu if absent."
    )
    keep: Keep | None = Field(
        None,
        description="What stays once all is done. results: all but the frames, which are four "
        "fifths of the bytes; view, map and render need them. frames: these as well; they are made "
        "again if they were deleted. Default: as the run was started; frames for a new run.",
    )
    force: bool = Field(
        False,
        description="Continue a run that was started with other inputs or parameters; what they "
        "change is made again.",
    )
    dry_run: bool = Field(
        False, description="Check all inputs and tell what would be made; make nothing."
    )
    progress: Progress | None = None

    @model_validator(mode="after")
    def _one_kind_of_workers(self) -> Execution:
        if self.scheduler is not None and self.jobs > 1:
            raise ConfigError(
                "`jobs` are for this machine, `scheduler` for a cluster", "give one of them"
            )
        return self

    def workers(self) -> WorkerPool:
        """Who does the work."""
        return WorkerPool(self.threads, self.jobs, self.scheduler)

    def but(self, **changes: Any) -> Execution:
        """The same with other values."""
        return self.model_copy(update=changes)
