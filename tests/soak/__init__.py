"""Sweeps that are attacked at random moments, and must end as if nothing had happened."""
