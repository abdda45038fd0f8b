"""Sweeps on a real Slurm, and folders that several machines share."""
