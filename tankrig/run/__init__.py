"""Running an experiment: the runner, and the store that keeps what it saw."""
