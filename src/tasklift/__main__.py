"""``python -m tasklift``: the command line."""

from tasklift.cli.main import main

main()
