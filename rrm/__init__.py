"""Reward learning from preferences on top of known priors: the residual reward model and what it is compared with."""

__version__ = "0.1.0"
