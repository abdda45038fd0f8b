"""From jobs to finished runs: a scheduler, a pool of supervised processes, and the worker in each of them."""
