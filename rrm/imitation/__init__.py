"""Learning from demonstrations: their file format, adversarial inverse reinforcement learning, and its fine-tuning."""
