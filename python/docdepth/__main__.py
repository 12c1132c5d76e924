"""``python -m docdepth``: the command line, where its script is not on the path."""

from docdepth.cli import main

main()
