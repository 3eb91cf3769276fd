"""`python -m treebake`, the same as the command `treebake`."""

from treebake.cli import main

main()
