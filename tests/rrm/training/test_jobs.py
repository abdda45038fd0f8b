"""Stopping anywhere and going on gives the run that was never stopped."""

import math
import shutil
import subprocess
import sys
import textwrap

import pytest
import torch

from rrm.config import EvaluationConfig, MrnConfig, SacConfig, SurfConfig, TeacherConfig
from rrm.errors import NumericalError
from rrm.training.jobs import train
from rrm.training.loop import Trainer

METHODS = [
    {"learner": "true"},
    {"learner": "prior", "prior": "random"},
    {},
    {"prior": "proxy"},
    {"prior": "language", "inputs": "standard"},
    {"agent": SacConfig(hidden=16, layers=2, batch=16, critic_norm="layer", early_steps=400, target_every=1)},
    {
        "prior": "proxy", "normaliser": "zscore", "sampler": "kcenter-entropy",
        "teacher": TeacherConfig(beta=2.0, gamma=0.9, mistake=0.1, skip=0.1, equal=0.1),
    },
    {"learner": "surf", "surf": SurfConfig(threshold=0.6)},
    {"learner": "surf", "surf": SurfConfig(threshold=0.6), "prior": "proxy", "bound": "gaussian"},
    {"learner": "mrn", "mrn": MrnConfig(every=20)},
    {"learner": "mrn", "mrn": MrnConfig(every=20, meta_optimizer="separate", faithful_done=True), "prior": "proxy"},
]  # fmt: skip


def interrupted(config, folder, recorder, patience, **options):
    """Train in pieces of `patience` steps; all rows together, and how many pieces it took."""
    together, pieces = recorder(), 0
    while True:
        piece = recorder(patience)
        pieces += 1
        finished = train(config, folder, piece, **options)
        together.rows |= piece.rows
        if finished:
            return together, pieces


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS, ids=str)
@pytest.mark.parametrize("patience", [1, 97])
def test_a_run_in_pieces_is_the_run(tiny, recorder, networks, tmp_path, method, patience):
    """Stopped every n steps and resumed, rows and final networks are equal bit for bit."""
    config = tiny(**method, steps=260 if patience == 1 else 700)
    straight = recorder()
    assert train(config, tmp_path / "a", straight)
    pieces, count = interrupted(config, tmp_path / "b", recorder, patience)
    assert count > 5
    assert straight.numbers() == pieces.numbers()
    assert networks(tmp_path / "a") == networks(tmp_path / "b")


def test_what_agent_and_learner_say_of_themselves_is_in_the_row(tiny, recorder, tmp_path):
    """The figures of SAC, those of learning from preferences, and the learner's own; the oracle has the first alone."""
    sac = {"critic_loss", "actor_loss", "entropy", "alpha"}
    asked = sac | {"label_accuracy", "true_accuracy"}
    mrn = {"meta_gradient", "meta_cosine", "meta_steps"}
    for name, figures in (
        ("true", sac),
        ("pebble", asked),
        ("surf", asked | {"pseudo_labelled"}),
        ("mrn", asked | mrn),
    ):
        monitor = recorder()
        train(tiny(name, mrn=MrnConfig(every=20)), tmp_path / name, monitor)
        assert [set(row.figures) for row in monitor.rows.values()] == [figures] * 3
        assert all(map(math.isfinite, monitor.rows[700].figures.values()))


@pytest.mark.slow
def test_checkpoints_at_other_times_change_nothing(tiny, recorder, networks, tmp_path):
    """Saving after every step gives the numbers of saving at evaluations alone."""
    one, other = recorder(), recorder()
    train(tiny(), tmp_path / "a", one)
    train(tiny(), tmp_path / "b", other, checkpoint_every_s=0)
    assert one.numbers() == other.numbers()
    assert networks(tmp_path / "a") == networks(tmp_path / "b")


@pytest.mark.parametrize("damage", ["state", "log", "both", "all"])
def test_damaged_checkpoints_cost_steps_not_the_run(tiny, recorder, networks, tmp_path, damage):
    """Whatever is damaged, an older checkpoint or step 0 is used, it is said, and the curve is the same."""
    straight = recorder()
    train(tiny(), tmp_path / "a", straight)
    folder = tmp_path / "b" / "checkpoint"
    first, second = recorder(200), recorder(200)
    train(tiny(), tmp_path / "b", first)
    train(tiny(), tmp_path / "b", second)
    states = sorted(folder.glob("state-*.safetensors"))
    assert [int(p.stem.split("-")[1]) for p in states] == [250, 400]
    if damage in ("state", "both"):
        states[-1].write_bytes(states[-1].read_bytes()[:-9])
    if damage in ("log", "both"):
        log = folder / "transitions.bin"
        data = bytearray(log.read_bytes())
        data[-5] ^= 1
        log.write_bytes(data)
    if damage == "all":
        shutil.rmtree(folder)
        folder.mkdir()
        for name in ("state-000000000400", "state-000000000250"):
            (folder / f"{name}.json").write_text("{}")
    rest = recorder()
    assert train(tiny(), tmp_path / "b", rest)
    assert any("set aside" in note for note in rest.notes)
    again = ["starting again from step 0"] if damage == "all" else ["of step 250; 150 steps are trained again"]
    assert any(note.endswith(tuple(again)) for note in rest.notes)
    assert straight.numbers() == rest.numbers(), "the checkpoint brings back the evaluations before it"
    assert networks(tmp_path / "a") == networks(tmp_path / "b")


@pytest.mark.slow
def test_killed_with_sigkill_it_goes_on(tiny, recorder, networks, tmp_path):
    """A process killed outright, again and again, leaves what a fresh one continues to the same end."""
    config = tiny(prior="proxy")
    straight = recorder()
    train(config, tmp_path / "a", straight)
    script = textwrap.dedent("""
        import contextlib, os, signal, sys
        from pathlib import Path
        from rrm.training.run_config import RunConfig
        from rrm.training.jobs import train
        class Fatal:
            steps = 0
            def restored(self, rows): pass
            def row(self, row): pass
            def note(self, message): pass
            def beat(self, *_): pass
            def writing(self): return contextlib.nullcontext()
            def should_stop(self):
                self.steps += 1
                if self.steps == 190:
                    os.kill(os.getpid(), signal.SIGKILL)
                return False
        train(RunConfig.model_validate_json(sys.argv[1]), Path(sys.argv[2]), Fatal(), checkpoint_every_s=0.01)
    """)
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", script, config.model_dump_json(), str(tmp_path / "b")], check=False
        )
        assert done.returncode == -9
    rest = recorder()
    assert train(config, tmp_path / "b", rest)
    assert any("continuing from the checkpoint" in note for note in rest.notes)
    assert straight.numbers()[-1] == rest.numbers()[-1]
    assert networks(tmp_path / "a") == networks(tmp_path / "b")


def test_a_finished_run_keeps_its_networks_only(tiny, recorder, tmp_path):
    """The experience of a finished run is not kept."""
    train(tiny(), tmp_path, recorder())
    assert [path.name for path in tmp_path.iterdir()] == ["model.safetensors"]


@pytest.mark.parametrize(
    ("what", "told"),
    [
        ("critic", r"critic is not finite in [\d,]+ of [\d,]+ numbers \(at step 200; the last good .* of step 100\)"),
        ("reward", r"step 250: the reward is nan; .* \(the last good checkpoint is of step 200\)"),
        ("last", r"critic is not finite in [\d,]+ of [\d,]+ numbers \(at step 300; the last good .* of step 200\)"),
    ],
)
def test_numbers_that_are_not_finite_stop_the_run(tiny, recorder, tmp_path, monkeypatch, what, told):
    """The message names step, tensor and the last good checkpoint; that one is used when the cause is gone."""
    advance = Trainer.advance

    def poisoned(trainer):
        advance(trainer)
        if trainer.step == {"critic": 200, "last": 300}.get(what):
            trainer.agent.critic.flat[0] = torch.nan
        elif what == "reward" and trainer.step == 250:
            weights = trainer.weights()["reward"]["weights"]
            trainer.sources["preferences"].learner.reward.load_state_dict(
                {"weights": torch.full_like(weights, torch.nan)}
            )

    config = tiny(steps=300, evaluation=EvaluationConfig(every=100, episodes=1))
    monkeypatch.setattr(Trainer, "advance", poisoned)
    with pytest.raises(NumericalError, match=told):
        train(config, tmp_path, recorder())
    assert not (tmp_path / "model.safetensors").exists()
    monkeypatch.undo()
    again = recorder()
    assert train(config, tmp_path, again)
    assert any("continuing from the checkpoint of step" in note for note in again.notes)
