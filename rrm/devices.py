"""Where networks learn: this machine's processor, or a graphics card. Nothing here imports torch.

Which kind of device it is is part of a run's identity: each adds the same numbers up in an order of its own.
"""

from __future__ import annotations

import ctypes
import re
from contextlib import suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, NamedTuple

from pydantic import Field, ValidatorFunctionWrapHandler, WrapValidator

from rrm.errors import ConfigError

CPU, CUDA = "cpu", "cuda"

_WANTED = r"^(cpu|cuda(:\d+)?)$"
_LIBRARY = "libcuda.so.1"
_NAME_BYTES = 256


class Card(NamedTuple):
    """A graphics card, as CUDA counts them here: `CUDA_VISIBLE_DEVICES` hides some, and has a say in their order."""

    number: int
    name: str
    memory: int  #: bytes


def _meant(value: object, handler: ValidatorFunctionWrapHandler) -> object:
    return (CUDA if not missing() else CPU) if value == "auto" else handler(value)


#: cpu, cuda, cuda:1, or "auto"; what is stored is what that meant on the machine that planned the run.
DeviceSetting = Annotated[str, Field(pattern=_WANTED), WrapValidator(_meant)]


def kind_of(device: str) -> str:
    """The one, `cpu` or `cuda`."""
    return device.partition(":")[0]


def check_device(device: str) -> None:
    """Refuse a device that this machine does not have: a ConfigError says what is missing."""
    if kind_of(device) != CUDA:
        return
    if why := missing():
        raise ConfigError(
            f'device: {device} cannot be used here: {why}; use device = "cpu", or "auto" to take what is there'
        )
    number = int(device.partition(":")[2] or 0)
    if number >= len(cards()):
        raise ConfigError(f"device: there is no {device} here; the cards are {', '.join(map(in_words, cards()))}")


def in_words(card: Card) -> str:
    """Its number, name and memory."""
    return f"cuda:{card.number} ({card.name}, {card.memory / 2**30:.0f} GiB)"


def missing() -> str:
    """What keeps CUDA from being used here, in words; empty where nothing does."""
    if cuda_of_torch() is None:
        return "the torch that is installed is built without CUDA"
    if not cards():
        return "no NVIDIA card is found (CUDA's driver lists none)"
    return ""


@cache
def cards() -> tuple[Card, ...]:
    """The cards that CUDA's driver lists; none where there is no driver."""
    try:
        driver = ctypes.CDLL(_LIBRARY)
    except OSError:
        return ()
    count, found = ctypes.c_int(), []
    if driver.cuInit(0) or driver.cuDeviceGetCount(ctypes.byref(count)):
        return ()
    for index in range(count.value):
        device, size, name = ctypes.c_int(), ctypes.c_size_t(), ctypes.create_string_buffer(_NAME_BYTES)
        driver.cuDeviceGet(ctypes.byref(device), index)
        driver.cuDeviceGetName(name, _NAME_BYTES, device)
        driver.cuDeviceTotalMem_v2(ctypes.byref(size), device)
        found.append(Card(index, name.value.decode(errors="replace"), size.value))
    return tuple(found)


def driver_version() -> str | None:
    """Of the NVIDIA driver of the system; None where there is none, or it does not tell."""
    with suppress(OSError):
        told = re.search(
            r"Kernel Module.*?\s(\d[\d.]+)\s", Path("/proc/driver/nvidia/version").read_text(errors="replace")
        )
        return told[1] if told else None
    return None


@cache
def cuda_of_driver() -> str | None:
    """The newest CUDA that the driver speaks, such as "12.4"; None where there is none."""
    number = ctypes.c_int()
    try:
        if ctypes.CDLL(_LIBRARY).cuDriverGetVersion(ctypes.byref(number)):
            return None
    except OSError:
        return None
    return f"{number.value // 1000}.{number.value % 1000 // 10}"


def cuda_of_torch() -> str | None:
    """The version of CUDA that the installed torch is built for, such as "13.0"; None where it is built without."""
    spec = find_spec("torch")
    if spec is None or spec.origin is None:
        return None
    told = re.search(r"^cuda\b[^=]*= *'([\d.]+)'", Path(spec.origin).with_name("version.py").read_text(), re.MULTILINE)
    return told[1] if told else None
