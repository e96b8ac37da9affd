"""One file per command: options -> pipeline call -> printed summary -> exit code."""
