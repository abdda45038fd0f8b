"""On a graphics card: what is recorded computes what plain code does, the same every time, interrupted or not."""

import numpy as np
import pytest
import torch

from rrm import devices
from rrm.agents import drqv2
from rrm.agents.drm import Drm
from rrm.agents.drqv2 import Drq
from rrm.agents.sac import Sac
from rrm.buffers import experience as experience_module
from rrm.buffers.experience import Experience
from rrm.buffers.table import Table
from rrm.checkpoint import decode, encode
from rrm.config import CameraConfig, DrmConfig, DrqConfig, RewardConfig, SacConfig
from rrm.envs import Spaces
from rrm.errors import ConfigError
from rrm.losses import window_sums
from rrm.nets.captured import Captured, prepare
from rrm.nets.shift import pictures
from rrm.rewards.ensemble import ResidualReward
from rrm.seeding import Streams
from rrm.training.jobs import train
from rrm.training.run_config import RunConfig
from rrm.types import Batch, Obs, Segments, State
from tests.rrm.agents.reference_sac import ReferenceSac
from tests.rrm.agents.test_drm import SMALL as SMALL_DRM
from tests.rrm.agents.test_drqv2 import SMALL as SMALL_DRQ
from tests.rrm.agents.test_drqv2 import SPACES as SEEN
from tests.rrm.agents.test_drqv2 import windows
from tests.rrm.agents.test_sac import assert_same
from tests.rrm.buffers.test_experience import lived
from tests.rrm.training.conftest import networks, recorder, tiny  # noqa: F401 (fixtures)
from tests.rrm.training.test_imitation import METHODS as IMITATED
from tests.rrm.training.test_imitation import expert, imitating, results  # noqa: F401
from tests.rrm.training.test_jobs import METHODS, interrupted

on_a_card = pytest.mark.skipif(bool(devices.missing()), reason=f"CUDA cannot be used here: {devices.missing()}")

OBS, ACT = 39, 4
GIVEN = ("act", "reward", "continues", "frames")  #: of a batch, to agents that see frames


def a_batch(rows: int) -> Batch:
    obs, next_obs = torch.randn(2, rows, OBS)
    on = (torch.rand(rows) > 0.1).float()
    return Batch(obs, torch.rand(rows, ACT) * 2 - 1, torch.zeros(rows), torch.randn(rows), next_obs, on)


def seeing(agent: type[Drq], config: DrqConfig, device: str) -> tuple[list[list[float]], dict[str, float], State]:
    """An agent that sees frames, after some updates: its actions meanwhile, its figures, its state."""
    one = agent(config, SEEN, Streams(5), device=device)
    acts = []
    for seed in range(6):
        one.at(200 * seed)  # DrM is perturbed on the way
        batch = windows(seed)
        one.update(batch._replace(**{name: getattr(batch, name).to(device) for name in GIVEN}))
        obs = Obs(np.zeros(5, np.float32), batch.frames[0, : SEEN.frames.stack].numpy())
        acts.append(one.act(obs, explore=seed % 2 == 0).tolist())
    return acts, one.figures(), one.state_dict()


def there(batch: Batch) -> Batch:
    return Batch(*(None if part is None else part.to("cuda") for part in batch))


@on_a_card
@pytest.mark.parametrize(("precision", "tolerance"), [("float32", 2e-5), ("tf32", 3e-3), ("bfloat16", 3e-2)])
def test_a_recorded_update_is_the_textbooks(precision, tolerance):
    """From the same weights, with the noise that the card drew."""
    torch.manual_seed(0)
    prepare("cuda", precision)
    config = SacConfig(hidden=64, layers=3, batch=128)
    sac = Sac(config, Spaces(OBS, ACT), Streams(1), precision=precision, device="cuda")
    plain = Sac(config, Spaces(OBS, ACT), Streams(1))
    assert torch.equal(sac.actor.flat.cpu(), plain.actor.flat), "weights do not depend on the device"
    textbook = ReferenceSac(config, plain.actor, plain.critic)
    for _ in range(6):
        batch = a_batch(config.batch)
        sac.update(there(batch))
        noise = sac._space.sample._drawn.cpu().t()
        told = textbook.update(batch, noise[: config.batch], noise[config.batch :])
        figures = sac.figures()
        for name, figure in told.items():
            assert figures[name] == pytest.approx(figure, rel=20 * tolerance, abs=20 * tolerance), name
    learned = torch.cat([p.detach().flatten() for p in textbook.actor.parameters()]).norm()
    assert sac.actor.flat.norm().item() == pytest.approx(learned.item(), rel=tolerance)
    assert sac._adams["actor"].state_dict()["steps"].item() == 6


@on_a_card
def test_recording_changes_nothing_that_is_learned():
    """Whether the first update is this process' first or hundredth: a state saved before it leads to the same."""

    def updated(state=None, streams=None, updates=3):
        torch.manual_seed(3)
        batches = [there(a_batch(64)) for _ in range(6)]
        streams_now = Streams(5)
        sac = Sac(SacConfig(hidden=32, layers=2, batch=64), Spaces(OBS, ACT), streams_now, device="cuda")
        begin = 0
        if state is not None:
            sac.load_state_dict(state)
            streams_now.load_state_dict(streams)
            begin = 3
        for batch in batches[begin : begin + updates]:
            sac.update(batch)
            sac.act(Obs(np.zeros(OBS, np.float32)), explore=True)
        return sac.state_dict(), streams_now.state_dict()

    prepare("cuda", "float32")
    whole, _ = updated(updates=6)
    half, streams = updated()
    rest, _ = updated(decode(encode(half)), streams)
    for name in ("actor", "critic", "target", "log_alpha"):
        assert torch.equal(whole["tensors"][name], rest["tensors"][name]), name


@on_a_card
def test_what_is_recorded_draws_from_where_its_generator_stands(monkeypatch):
    """The first time, too, on a card that is busy: what torch does for a record, on another stream, comes before."""
    generator = torch.Generator("cuda").manual_seed(1)

    def drawing():
        numbers = torch.empty(8, device="cuda")

        def work():
            torch.cuda._sleep(100_000_000)  # some 50 ms
            return numbers.normal_(generator=generator)

        return Captured(work, "cuda", generators=[generator])

    def busy():
        for _ in range(32):  # every stream that torch hands out
            with torch.cuda.stream(torch.cuda.Stream()):
                torch.cuda._sleep(40_000_000)

    first = drawing()
    first()
    stands = generator.get_state()
    wanted = [first().tolist() for _ in range(2)]
    generator.set_state(stands)
    monkeypatch.setattr(torch.cuda, "empty_cache", busy)  # which torch does before it prepares for a record
    second = drawing()
    assert [second().tolist() for _ in range(2)] == wanted


@on_a_card
@pytest.mark.parametrize(("agent", "config"), [(Drq, SMALL_DRQ), (Drm, SMALL_DRM)])
def test_what_is_recorded_of_agents_that_see_frames(agent, config, monkeypatch):
    """Updates and actions are those of the same code, not recorded."""
    prepare("cuda", "float32")

    recorded = seeing(agent, config, "cuda")
    monkeypatch.setattr(Captured, "__call__", lambda self: self._work())
    plain = seeing(agent, config, "cuda")
    assert recorded[:2] == plain[:2]
    assert_same(recorded[2], plain[2])


@on_a_card
@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS, ids=str)
def test_a_run_in_pieces_is_the_run(tiny, recorder, networks, tmp_path, method):  # noqa: F811
    """Every learner, trained twice and once in pieces: equal bit for bit."""
    config = tiny(**method, device="cuda")
    straight = recorder()
    assert train(config, tmp_path / "a", straight)
    pieces, count = interrupted(config, tmp_path / "b", recorder, 197)
    assert count > 3
    assert straight.numbers() == pieces.numbers()
    assert networks(tmp_path / "a") == networks(tmp_path / "b")


@on_a_card
@pytest.mark.slow
@pytest.mark.parametrize("method", IMITATED)
def test_imitation_in_pieces_is_imitation(imitating, results, recorder, networks, tmp_path, method):  # noqa: F811
    """The discriminator, and g trained further."""
    config = imitating(**IMITATED[method], device="cuda")
    straight, together = recorder(), recorder()
    assert train(config, tmp_path / "a", straight, results)
    finished = False
    while not finished:
        piece = recorder(173)
        finished = train(config, tmp_path / "b", piece, results)
        together.rows |= piece.rows
    assert straight.numbers() == together.numbers()
    assert networks(tmp_path / "a") == networks(tmp_path / "b")


@on_a_card
@pytest.mark.slow
@pytest.mark.parametrize("agent", [DrqConfig, DrmConfig])
def test_agents_that_see_frames(tiny, recorder, networks, tmp_path, agent):  # noqa: F811
    """On the toy car's pictures, with a learned reward."""
    kind = {DrqConfig: "drqv2", DrmConfig: "drm"}[agent]
    seen = agent(kind=kind, channels=8, strides=(2, 1), hidden=16, layers=1, batch=16, features=8)
    config = tiny(
        prior="proxy", task="toy-car-image", agent=seen, steps=420, camera=CameraConfig(size=16), device="cuda",
        exploration=tiny().exploration.model_copy(update={"unsupervised_steps": 0}),
    )  # fmt: skip
    straight = recorder()
    assert train(config, tmp_path / "a", straight)
    pieces, _ = interrupted(config, tmp_path / "b", recorder, 137)
    assert straight.numbers() == pieces.numbers()
    assert networks(tmp_path / "a") == networks(tmp_path / "b")


@on_a_card
def test_rewards_are_those_of_the_processor():
    prepare("cuda", "float32")
    config = RewardConfig(hidden=32, layers=2)
    segments = Segments(torch.randn(8, 10, OBS), torch.rand(8, 10, ACT), torch.randn(8, 10))
    here = ResidualReward(config, OBS, ACT, torch.Generator().manual_seed(0))
    card = ResidualReward(config, OBS, ACT, torch.Generator().manual_seed(0), device="cuda")
    told = card.members(Segments(*(part.to("cuda") for part in segments)))
    torch.testing.assert_close(told.cpu(), here.members(segments), rtol=1e-4, atol=1e-5)


@on_a_card
def test_pictures_are_moved_as_on_the_processor():
    frames = torch.randint(0, 256, (5, 3, 3, 12, 9), dtype=torch.uint8)
    moves = torch.randint(-4, 5, (5, 2))
    assert torch.equal(pictures(frames.to("cuda")).cpu(), pictures(frames))
    assert torch.equal(pictures(frames.to("cuda"), moves.to("cuda")).cpu(), pictures(frames, moves))


@on_a_card
def test_windows_on_a_card_are_those_of_the_processor():
    rewards = torch.randn(2, 6, 20)
    starts = torch.randint(0, 10, (2, 6, 2))
    ends = starts + torch.randint(1, 10, (2, 6, 2))
    card = window_sums(*(part.to("cuda") for part in (rewards, starts, ends)))
    torch.testing.assert_close(card.cpu(), window_sums(rewards, starts, ends), rtol=1e-5, atol=1e-5)


# What a card makes different, on the processor.


def test_the_rows_of_a_table_are_those_of_the_columns(tiny, recorder, networks, tmp_path, monkeypatch):  # noqa: F811
    """A run whose experience keeps a table beside it, saved and resumed, is the run without."""
    config = tiny(prior="proxy", steps=500)
    straight = recorder()
    assert train(config, tmp_path / "a", straight)
    monkeypatch.setattr(experience_module, "CPU", "nowhere")
    assert isinstance(Experience(10, 5, Spaces(3, 2)).near, Table)
    pieces, count = interrupted(config, tmp_path / "b", recorder, 180)
    assert count > 2
    assert straight.numbers() == pieces.numbers()
    assert networks(tmp_path / "a") == networks(tmp_path / "b")


@pytest.mark.parametrize(("agent", "config"), [(Drq, SMALL_DRQ), (Drm, SMALL_DRM)])
def test_what_is_seen_is_put_in_one_place(agent, config, monkeypatch):
    """An agent that copies batches and frames to where it looked before learns what one does that looks at them."""
    plain = seeing(agent, config, "cpu")
    monkeypatch.setattr(drqv2, "CPU", "nowhere")
    copied = seeing(agent, config, "cpu")
    assert copied[:2] == plain[:2]
    assert_same(copied[2], plain[2])


def test_a_table_grows(monkeypatch):
    """Where more rows come than were foreseen, none is lost."""
    lengths = [5, 7, 4]
    plain = lived(lengths, unfinished=3)
    monkeypatch.setattr(experience_module, "CPU", "nowhere")
    table = lived(lengths, unfinished=3)
    numbers = torch.arange(plain.transitions)
    for ends in (False, True):
        both = (each.batch(numbers, time_limits_end=ends) for each in (table, plain))
        for one, other in zip(*both, strict=True):
            assert one is other is None or torch.equal(one, other)


def test_without_a_card_it_is_said(tiny, monkeypatch):  # noqa: F811
    monkeypatch.setattr(devices, "cuda_of_torch", lambda: "13.0")
    monkeypatch.setattr(devices, "cards", lambda: ())
    with pytest.raises(ConfigError, match="device: cuda cannot be used here: no NVIDIA card is found"):
        prepare("cuda", "float32")
    monkeypatch.setattr(devices, "cards", lambda: (devices.Card(0, "Some Card", 80 << 30),))
    with pytest.raises(ConfigError, match=r"there is no cuda:1 here; the cards are cuda:0 \(Some Card, 80 GiB\)"):
        prepare("cuda:1", "float32")


def test_the_kind_of_device_is_part_of_a_run(tiny):  # noqa: F811
    run = tiny()
    one, other = (RunConfig.model_validate(run.model_dump() | {"device": device}) for device in ("cuda", "cuda:1"))
    assert one.identity == other.identity != run.identity
    assert other.canonical().device == "cuda"
    with pytest.raises(ValueError, match="tf32 is a precision of graphics cards"):
        RunConfig.model_validate(run.model_dump() | {"precision": "tf32"})
    with pytest.raises(ValueError, match="pattern"):
        RunConfig.model_validate(run.model_dump() | {"device": "tpu"})


def test_auto_is_what_is_there(tiny, monkeypatch):  # noqa: F811
    for why, kind in (("no NVIDIA card is found", "cpu"), ("", "cuda")):
        monkeypatch.setattr(devices, "missing", lambda why=why: why)
        assert RunConfig.model_validate(tiny().model_dump() | {"device": "auto"}).device == kind
