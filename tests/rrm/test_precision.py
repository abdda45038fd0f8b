"""The precision of a run is one of two; "auto" is what was measured."""

from pathlib import Path

import pytest
from pydantic import ValidationError

from rrm import precision
from rrm.hardware import extensions
from rrm.tuning import FORMS, ROUNDED, SEEING, SHAPES, Machine, cell
from tests.rrm.training.test_run_config import run


def measured(rounded: float) -> Machine:
    """A machine whose exact products are of rate 1 and whose rounded ones of this rate, from batches of 512 on."""
    cells = {cell(form, shape): shape for form in FORMS for shape in SHAPES}
    slow_at_small = {name: rounded if shape[0] >= 512 else 0.5 for name, shape in cells.items()}
    return Machine({"torch": dict.fromkeys(cells, 1.0), ROUNDED: slow_at_small})


@pytest.mark.parametrize(("rounded", "best"), [(2.0, "bfloat16"), (1.1, "float32")])
def test_auto_is_what_pays_on_the_machine(monkeypatch: pytest.MonkeyPatch, rounded: float, best: str) -> None:
    """What is stored, and enters the identity, is the arithmetic and not the word; it depends on the sizes."""
    monkeypatch.setattr(precision, "machine", lambda: measured(rounded))
    assert run(precision="auto").precision == best
    assert run(precision="auto").identity == run(precision=best).identity
    assert run(precision="auto", agent={"batch": 128, "hidden": 128}).precision == "float32"


@pytest.mark.parametrize(
    ("gains", "best"), [({16: 1.1, 32: 2.0}, ["float32", "bfloat16"]), ({16: 2.0, 32: 1.1}, ["bfloat16", "float32"])]
)
def test_auto_on_images_goes_by_convolutions(
    monkeypatch: pytest.MonkeyPatch, gains: dict[int, float], best: list[str]
) -> None:
    """Of about as many channels, whatever is measured of layers: those of such an agent are in float32 anyway."""
    exact, rounded = {str(channels): 1.0 for channels in gains}, {str(key): gain for key, gain in gains.items()}
    for layers in (2.0, 0.5):
        seeing = dict(zip(SEEING.values(), (exact, rounded), strict=True))
        here = Machine({**measured(layers).rates, **seeing})
        monkeypatch.setattr(precision, "machine", lambda here=here: here)
        for channels, meant in zip((12, 40), best, strict=True):
            agent = {"kind": "drqv2", "channels": channels}
            assert run(task="toy-car-image", agent=agent, action_repeat=2, precision="auto").precision == meant
    monkeypatch.setattr(precision, "machine", lambda: Machine({**measured(2.0).rates, SEEING["float32"]: exact}))
    assert run(task="toy-car-image", agent={"kind": "drqv2"}, action_repeat=2, precision="auto").precision == "float32"


def test_auto_without_rounded_products(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the processor has none, there is nothing to gain."""
    monkeypatch.setattr(precision, "machine", lambda: Machine({"torch": measured(1.0).rates["torch"]}))
    assert run(precision="auto").precision == "float32"


def test_precision_is_part_of_the_identity() -> None:
    """The two are different runs and different cells; float32 is the default."""
    assert run().identity == run(precision="float32").identity != run(precision="bfloat16").identity
    assert run().cell != run(precision="bfloat16").cell


def test_an_unknown_precision_is_refused() -> None:
    """Half precision is none of ours."""
    with pytest.raises(ValidationError, match="float32"):
        run(precision="float16")


def test_a_system_that_does_not_tell(tmp_path: Path) -> None:
    """Without a description of the processor there are no extensions."""
    assert extensions(tmp_path / "absent") == frozenset()
