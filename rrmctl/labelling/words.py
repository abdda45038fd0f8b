"""What people are told: what the robot is to do, and what practice would have been answered right by."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rrm.teachers.labels import SECOND

if TYPE_CHECKING:
    from rrm.teachers.labels import Label

#: What is wanted of the robot, by task.
TASKS = {
    "button-press": "The robot should press the red button into the yellow box.",
    "door-open": "The robot should pull the door open by its handle, to the green point.",
    "door-unlock": "The robot should turn the lock on the door.",
    "sweep-into": "The robot should sweep the little block into the hole, at the blue point.",
    "window-open": "The robot should slide the window open by its handle, to the green point.",
    "walker-walk": "The body should stand upright and walk to the right.",
    "quadruped-walk": "The body should stand on its four legs and walk.",
    "panda-reach": "The robot should bring its fingers to the cube.",
    "panda-push": "The robot should push the cube to the green point.",
    "panda-pick-and-reach": "The robot should pick up the cube and bring it to the green point.",
    "toy-car": "The blue car should drive to the green goal soon, and pass the grey obstacles slowly.",
}
TASKS |= {f"{name}-image": TASKS[name] for name in ("button-press", "sweep-into")}
TASKS["toy-car-image"] = "The blue car should drive to the green goal soon."


def better(row: Label) -> str:
    """The side of the better clip, by the true return."""
    return "left" if (row.return_second > row.return_first) == (row.shown_left == SECOND) else "right"
