"""A run of ours beside the same run on the textbook's agent in plain autograd: how far apart rounding leads them."""

import pytest
import torch

from rrm.agents import AGENTS
from rrm.agents.sac import Sac
from rrm.config import EvaluationConfig, ExplorationConfig, RewardConfig, SacConfig
from rrm.training.loop import Trainer
from rrm.training.run_config import RunConfig
from rrm.types import Batch, EvalRow
from tests.rrm.agents.reference_sac import ReferenceSac

STEPS = 2000


class Textbook(Sac):
    """Acts by the networks of ours, which the textbook trains with the same noise."""

    textbook: ReferenceSac | None = None

    def update(self, batch: Batch) -> None:
        if self.textbook is None:
            self.textbook = ReferenceSac(self.config, self.actor, self.critic)
        rows = len(batch.reward)
        noise = torch.empty(self.act_dim, 2 * rows).normal_(generator=self._noise).t()
        self.textbook.update(batch, *noise.split(rows))
        with torch.no_grad():
            weights, biases = self.actor.weights[::2], self.actor.weights[1::2]
            for weight, bias, linear in zip(weights, biases, self.textbook.actor[::2], strict=True):
                weight[0].copy_(linear.weight.t())
                bias[0, 0].copy_(linear.bias)


def curve(monkeypatch: pytest.MonkeyPatch, agent: str) -> list[EvalRow]:
    monkeypatch.setitem(AGENTS, "sac", agent)
    trainer = Trainer(
        RunConfig(
            task="toy-car", seed=0, steps=STEPS, agent=SacConfig(hidden=64, layers=2, batch=64),
            reward=RewardConfig(learner="true"), feedback=None, teacher=None,
            exploration=ExplorationConfig(seed_steps=200), evaluation=EvaluationConfig(every=250, episodes=4),
        )
    )  # fmt: skip
    rows = []
    while trainer.step < STEPS:
        trainer.advance()
        if trainer.step % 250 == 0:
            rows.append(trainer.evaluate())
    trainer.close()
    return rows


@pytest.mark.slow
@pytest.mark.long
def test_the_curve_is_the_textbooks(monkeypatch: pytest.MonkeyPatch) -> None:
    """For hundreds of updates the returns are equal but for rounding; what it grows to in 1,800 is a few percent."""
    ours = curve(monkeypatch, "rrm.agents.sac:Sac")
    theirs = curve(monkeypatch, f"{__name__}:Textbook")
    for mine, textbooks in zip(ours, theirs, strict=True):
        near = 1e-3 if mine.step <= 750 else 0.1
        assert mine.true_return == pytest.approx(textbooks.true_return, rel=near), mine.step
        assert mine.success == textbooks.success
    assert ours[-1].true_return > ours[0].true_return + 5  # there was something to learn, and it was learned
