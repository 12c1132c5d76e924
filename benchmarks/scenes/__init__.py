"""Streets that only benchmarks and tests drive, beside docdepth's ``city`` and ``crossing``.

Importing this package adds them to :data:`docdepth.synthetic.SCENES`, and their vehicles to the
kinds of actors. ``endless`` holds a drive of any length, which is made while it is read.
"""

from docdepth.synthetic import SCENES
from docdepth.synthetic.street import KINDS
from scenes.fences import fences, still_fences
from scenes.groups import groups
from scenes.large_vehicles import LARGE_VEHICLES
from scenes.residential import residential
from scenes.rural import highway, hills
from scenes.traffic import arrivals, overtaking, queue

KINDS.update(LARGE_VEHICLES)
SCENES.update(
    {
        scene.__name__: scene
        for scene in (
            residential,
            hills,
            highway,
            arrivals,
            overtaking,
            queue,
            fences,
            still_fences,
            groups,
        )
    }
)
