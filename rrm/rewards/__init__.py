"""Reward functions (ensemble, residual) and the learners that train them. No torch is imported here."""

#: Learners by name. `true` and `prior` are known rewards and need no learner.
LEARNERS: dict[str, str] = {
    "pebble": "rrm.rewards.pebble:Pebble",
    "surf": "rrm.rewards.surf:Surf",
    "mrn": "rrm.rewards.mrn:Mrn",
    "finetune": "rrm.imitation.finetune:Finetune",
}
