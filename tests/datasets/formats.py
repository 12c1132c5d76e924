"""All writers of the made-up drive."""

import captures  # noqa: F401  (registers its writers)
import long_drives  # noqa: F401  (registers its writers)
import vehicles  # noqa: F401  (registers its writers)
import waymo_files  # noqa: F401  (registers its writers)
from writers import WRITERS, Written

__all__ = ["WRITERS", "Written"]
