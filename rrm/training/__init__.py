"""From a configuration to a curve: the loop, its evaluation, and the checkpoints in between."""
