"""``docdepth synth`` with the scenes of the benchmarks: ``python benchmarks/synth.py DRIVE --scene
hills``; ``--help`` lists them."""

import sys

import scenes  # noqa: F401

if __name__ == "__main__":
    from docdepth.cli import main

    sys.argv.insert(1, "synth")
    main()
