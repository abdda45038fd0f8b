"""Where the reward of a run comes from: known beforehand, state entropy, demonstrations, or preferences."""
