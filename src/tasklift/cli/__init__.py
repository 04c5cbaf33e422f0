"""The command line: parse and call, nothing else."""
