"""DrQ-v2 and DrM as plainly as PyTorch allows: its modules and autograd, pictures padded and cut out."""

import math
from collections.abc import Iterator

import torch
from torch import Tensor, nn
from torch.nn.functional import mse_loss, pad

from rrm.agents.drm import Drm
from rrm.agents.drqv2 import Drq
from rrm.nets.encoder import Encoder
from rrm.nets.tower import Tower
from rrm.types import Batch

Optimisers = dict[str, torch.optim.Optimizer]


class Convolutions(nn.Module):
    """An encoder."""

    def __init__(self, encoder: Encoder) -> None:
        super().__init__()
        self.layers, params = nn.Sequential(), encoder.parameters()
        for weight, bias, stride in zip(params[::2], params[1::2], encoder.strides, strict=True):
            conv = nn.Conv2d(weight.shape[3], len(weight), 3, stride)
            conv.weight.data = weight.detach().permute(0, 3, 1, 2).clone()
            conv.bias.data = bias.detach().clone()
            self.layers.extend([conv, nn.ReLU(inplace=True)])

    def forward(self, frames: Tensor) -> Tensor:
        """The features of pictures [B, planes, height, width], in the agent's order."""
        return self.layers(frames / 255.0 - 0.5).permute(0, 2, 3, 1).flatten(1)


class TrunkAndHeads(nn.Module):
    """A tower."""

    def __init__(self, tower: Tower) -> None:
        super().__init__()
        params = [p.detach().clone() for p in tower.parameters()]
        self.trunk = nn.Sequential(linear(*params[:2]), layer_norm(*params[2:4]), nn.Tanh())
        self.heads = nn.ModuleList(nn.Sequential(*_layers(tower, params[4:], m)) for m in range(tower.members))
        self.dropout = tower.dropout

    def forward(
        self, features: Tensor, act: Tensor | None = None, noise: torch.Generator | None = None
    ) -> list[Tensor]:
        h = self.trunk(features)
        outputs = [h if act is None else torch.cat((h, act), dim=-1)] * len(self.heads)
        for modules in zip(*self.heads, strict=True):
            if isinstance(modules[0], nn.Dropout):
                kept = torch.rand(len(outputs), *outputs[0].shape, generator=noise) >= modules[0].p
                outputs = [h * mask / (1 - modules[0].p) for h, mask in zip(outputs, kept, strict=True)]
            else:
                outputs = [module(h) for module, h in zip(modules, outputs, strict=True)]
        return [h.squeeze(-1) if act is not None else h for h in outputs]


def _layers(tower: Tower, params: list[Tensor], member: int) -> Iterator[nn.Module]:
    rest = iter(param[member] for param in params)
    for layer in range(tower.layers + 1):
        yield linear(next(rest), next(rest))
        if layer < tower.layers:
            if tower.dropout is not None:
                yield nn.Dropout(tower.dropout)
                yield layer_norm(next(rest), next(rest))
            yield nn.ReLU(inplace=True)


def linear(weight: Tensor, bias: Tensor) -> nn.Linear:
    module = nn.Linear(weight.shape[1], weight.shape[0])
    module.weight.data, module.bias.data = weight, bias.flatten()
    return module


def layer_norm(gain: Tensor, offset: Tensor) -> nn.LayerNorm:
    module = nn.LayerNorm(gain.numel())
    module.weight.data, module.bias.data = gain.flatten(), offset.flatten()
    return module


class ReferenceDrq:
    """The textbook's, started from an agent's networks; `noise` is what its critics drop units by."""

    def __init__(self, agent: Drq, dtype: torch.dtype = torch.float32, noise: torch.Generator | None = None) -> None:
        self.config, self.dtype, self.noise = agent.config, dtype, noise
        self.encoder = Convolutions(agent.encoder).to(dtype)
        self.actor, self.critic, self.target = (
            TrunkAndHeads(tower).to(dtype) for tower in (agent.actor, agent.critic, agent.target)
        )
        self.adams = {
            name: torch.optim.Adam(net.parameters(), self.config.lr)
            for name, net in {"encoder": self.encoder, "actor": self.actor, "critic": self.critic}.items()
        }
        self.step = 0

    @property
    def stddev(self) -> float:
        return self.scheduled(self.step)

    def scheduled(self, step: int) -> float:
        mix = min(max(step / self.config.stddev_steps, 0.0), 1.0)
        return (1 - mix) * self.config.stddev + mix * self.config.last_stddev

    def moved(self, frames: Tensor, moves: Tensor) -> Tensor:
        """Padded by repeating the edge, and a part of the old size cut out of each."""
        reach, (height, width) = self.config.shift, frames.shape[3:]
        padded = pad(frames.flatten(1, 2).to(self.dtype), [reach] * 4, mode="replicate")
        return torch.stack([
            one[:, reach + y : reach + y + height, reach + x : reach + x + width]
            for one, (y, x) in zip(padded, moves.tolist(), strict=True)
        ])  # fmt: skip

    def sample(self, features: Tensor, noise: Tensor) -> Tensor:
        act = torch.tanh(self.actor(features)[0]) + (noise * self.stddev).clamp(
            -self.config.stddev_clip, self.config.stddev_clip
        )
        bounded = act.clamp(-1 + 1e-6, 1 - 1e-6)
        return act - act.detach() + bounded.detach()

    def q(self, critic: TrunkAndHeads, features: Tensor, act: Tensor) -> list[Tensor]:
        return critic(features, act, self.noise)

    def value(self, features: Tensor, noise: Tensor) -> Tensor:
        return torch.min(*self.q(self.target, features, self.sample(features, noise)))

    def update(self, batch: Batch, moves: Tensor, noise: Tensor, noise_next: Tensor) -> dict[str, float]:
        """One update, with moves [2, B, 2] and noise [B, A] for the frames and for those behind the window."""
        config, act = self.config, batch.act[:, 0].to(self.dtype)
        stack = batch.frames.shape[1] - config.n_step
        features = self.encoder(self.moved(batch.frames[:, :stack], moves[0]))
        self.look(features.detach(), act)
        reward, discount = torch.zeros(len(act), dtype=self.dtype), torch.ones(len(act), dtype=self.dtype)
        for i in range(config.n_step):
            reward += discount * batch.reward[:, i]
            discount *= config.discount * batch.continues[:, i]
        with torch.no_grad():
            following = self.encoder(self.moved(batch.frames[:, -stack:], moves[1]))
            q_target = reward + discount * self.value(following, noise_next)
        critic_loss = sum(mse_loss(q, q_target) for q in self.q(self.critic, features, act))
        self.descend(critic_loss, "critic", "encoder")

        features = features.detach()
        actor_loss = -torch.min(*self.q(self.critic, features, self.sample(features, noise))).mean()
        self.descend(actor_loss, "actor")
        with torch.no_grad():
            for target, param in zip(self.target.parameters(), self.critic.parameters(), strict=True):
                target.copy_(config.tau * param + (1 - config.tau) * target)
        return {"critic_loss": critic_loss.item(), "actor_loss": actor_loss.item(), "stddev": self.stddev}

    def look(self, features: Tensor, act: Tensor) -> None:
        """What DrM does first."""

    def descend(self, loss: Tensor, *names: str) -> None:
        params = [p for name in names for p in self.adams[name].param_groups[0]["params"]]
        for param, grad in zip(params, torch.autograd.grad(loss, params), strict=True):
            param.grad = grad
        for name in names:
            self.adams[name].step()


class ReferenceDrm(ReferenceDrq):
    """DrM on it, but for its perturbations."""

    def __init__(self, agent: Drm, dtype: torch.dtype = torch.float32, noise: torch.Generator | None = None) -> None:
        super().__init__(agent, dtype, noise)
        self.net = TrunkAndHeads(agent.value).to(dtype)
        self.adams["value"] = torch.optim.Adam(self.net.parameters(), self.config.lr)
        self.dormant_ratio, self.awake = 1.0, None

    @property
    def stddev(self) -> float:
        dormant = 1 / (1 + math.exp(-self.config.sharpness * (self.dormant_ratio - self.config.target_ratio)))
        return dormant if self.awake is None else max(dormant, self.scheduled(self.step - self.awake))

    def look(self, features: Tensor, act: Tensor) -> None:
        self.dormant_ratio = dormant_ratio(self.actor, features, self.config.dormant_share)
        if self.awake is None and self.dormant_ratio < self.config.target_ratio:
            self.awake = self.step
        q = torch.min(*self.q(self.critic, features, act)).detach()
        error = self.net(features)[0].squeeze(-1) - q
        weight = torch.where(error > 0, 1 - self.config.expectile, self.config.expectile)
        self.descend((weight * error**2).mean(), "value")

    def value(self, features: Tensor, noise: Tensor) -> Tensor:
        share = self.config.exploitation
        return share * self.net(features)[0].squeeze(-1) + (1 - share) * super().value(features, noise)


@torch.no_grad()
def dormant_ratio(actor: TrunkAndHeads, features: Tensor, share: float) -> float:
    """As DrM's code counts: what linear layers return is kept, and a ReLU in place then overwrites it."""
    kept: list[Tensor] = []
    hooks = [
        module.register_forward_hook(lambda _module, _inputs, output: kept.append(output))
        for module in actor.modules()
        if isinstance(module, nn.Linear)
    ]
    actor(features)
    for hook in hooks:
        hook.remove()
    sizes = [output.abs().mean(0) for output in kept]
    dormant = sum(int((size < share * size.mean()).sum()) for size in sizes)
    return dormant / sum(map(len, sizes))
