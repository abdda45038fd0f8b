"""The SAC of `rrm.agents.sac` as plainly as PyTorch allows: `nn.Linear`, `torch.distributions`, autograd."""

import copy
import math

import torch
from torch import Tensor, nn
from torch.distributions import Normal, TanhTransform, TransformedDistribution

from rrm.config import SacConfig
from rrm.nets.mlp import StackedMLP
from rrm.types import Batch


def unstack(net: StackedMLP) -> nn.ModuleList:
    """The stack's members as ordinary networks, one `nn.Sequential` each, with the same weights."""
    members = nn.ModuleList()
    params = net.parameters()
    for member in range(net.members):
        modules: list[nn.Module] = []
        for weight, bias in zip(params[::2], params[1::2], strict=True):
            linear = nn.Linear(weight.shape[1], weight.shape[2])
            linear.weight.data = weight[member].detach().t().clone()
            linear.bias.data = bias[member, 0].detach().clone()
            modules.append(linear)
            if net.normalised:
                modules.append(nn.LayerNorm(weight.shape[2], elementwise_affine=False))
            modules.append(nn.ReLU() if net.activation == "relu" else nn.LeakyReLU(0.01))
        members.append(nn.Sequential(*modules[: -2 if net.normalised else -1]))
    return members


class ReferenceSac:
    """Textbook soft actor-critic, started from the given networks; `fused` is torch's Adam in one kernel."""

    def __init__(self, config: SacConfig, actor: StackedMLP, critic: StackedMLP, *, fused: bool = False) -> None:
        self.config = config
        self.actor = unstack(actor)[0]
        self.critics = unstack(critic)
        self.targets = copy.deepcopy(self.critics)
        self.log_alpha = torch.tensor(math.log(config.initial_alpha), requires_grad=True)
        self.actor_adam = torch.optim.Adam(self.actor.parameters(), config.actor_lr, fused=fused)
        self.critic_adam = torch.optim.Adam(self.critics.parameters(), config.critic_lr, fused=fused)
        self.alpha_adam = torch.optim.Adam([self.log_alpha], config.alpha_lr, fused=fused)
        self.updates = 0

    def sample(self, obs: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        mean, raw = self.actor(obs).chunk(2, dim=-1)
        std = (-5 + 0.5 * 7 * (torch.tanh(raw) + 1)).exp()
        # The cache keeps the inverse of tanh exact.
        policy = TransformedDistribution(Normal(mean, std), TanhTransform(cache_size=1))
        act = policy.transforms[0](mean + std * noise)
        return act, policy.log_prob(act).sum(dim=-1)

    def smaller_q(self, critics: nn.ModuleList, obs: Tensor, act: Tensor) -> Tensor:
        return torch.min(*(critic(torch.cat((obs, act), dim=-1)).squeeze(-1) for critic in critics))

    def update(self, batch: Batch, noise_next: Tensor, noise: Tensor) -> dict[str, float]:
        alpha = self.log_alpha.exp()
        with torch.no_grad():
            act, log_prob = self.sample(batch.next_obs, noise_next)
            value = self.smaller_q(self.targets, batch.next_obs, act) - alpha * log_prob
            q_target = batch.reward + batch.continues * self.config.discount * value
        joined = torch.cat((batch.obs, batch.act), dim=-1)
        critic_loss = sum(
            (nn.functional.mse_loss(c(joined).squeeze(-1), q_target) for c in self.critics), torch.zeros(())
        )
        self.step(self.critic_adam, critic_loss)

        act, log_prob = self.sample(batch.obs, noise)
        actor_loss = (alpha.detach() * log_prob - self.smaller_q(self.critics, batch.obs, act)).mean()
        self.step(self.actor_adam, actor_loss)

        entropy = -log_prob.detach().mean()
        self.step(self.alpha_adam, alpha * (entropy - -batch.act.shape[1]))

        if self.updates % self.config.target_every == 0:
            with torch.no_grad():
                for target, param in zip(self.targets.parameters(), self.critics.parameters(), strict=True):
                    target.copy_(self.config.tau * param + (1 - self.config.tau) * target)
        self.updates += 1
        figures = {"critic_loss": critic_loss, "actor_loss": actor_loss, "entropy": entropy, "alpha": alpha}
        return {name: figure.item() for name, figure in figures.items()}

    @staticmethod
    def step(optimiser: torch.optim.Optimizer, loss: Tensor) -> None:
        params = optimiser.param_groups[0]["params"]
        for param, grad in zip(params, torch.autograd.grad(loss, params), strict=True):
            param.grad = grad
        optimiser.step()
