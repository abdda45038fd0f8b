"""Commands about an arm: `deploy RUN` and `deploy calibrate`."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from rrm.files import place
from rrmctl.cli.options import DEFAULT_RESULTS, ResultsOption
from rrmctl.cli.screen import plain_json, tell
from rrmctl.cli.stop_signals import resumable
from rrmctl.errors import UserError

if TYPE_CHECKING:
    from rrm.robot.deployment import Episode

#: What help calls the command that is named by none.
_RUN = "RUN"


class _Group(TyperGroup):
    """What is no command of the group is a run to be deployed."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        named = not args or args[0] in (*self.commands, *ctx.help_option_names)
        return super().parse_args(ctx, args if named else [_RUN, *args])


class _Play(TyperCommand):
    """Called as its argument is: usage names that once."""

    def collect_usage_pieces(self, _ctx: Any) -> list[str]:
        return [self.options_metavar or ""]


deploy_app = typer.Typer(
    cls=_Group, no_args_is_help=True, help="Have the policy of a run drive an arm, and calibrate its cameras."
)


@deploy_app.command(_RUN, cls=_Play)
@resumable(err=True)
def deploy(
    run: Annotated[str, typer.Argument(metavar=_RUN, help="The run's id, or enough of its first digits.")],
    checkpoint: Annotated[
        int | None,
        typer.Option(min=1, metavar="STEP", help="The policy of a step that was kept. Default: the run's end."),
    ] = None,
    episodes: Annotated[int, typer.Option(min=1, help="How many, with those that were played before.")] = 20,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="rig.KEY=VALUE", help="Change the workplace, e.g. rig.blur=2. Repeatable."),
    ] = None,
    results: ResultsOption = DEFAULT_RESULTS,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON for programs, at the end.")] = False,
) -> None:
    """Play a run's policy at the simulated workplace: it sees what two cameras and the arm say.

    Every episode is kept as it ends, in the folder deployments of the run. The same command goes on where it was
    stopped, and plays nothing that is there; with more --episodes, those that are missing.

      rrmctl deploy 2dcd --episodes 50

      rrmctl deploy 2dcd --checkpoint 20000 --set 'rig.friction=[0.3, 0.4]'
    """
    from rrmctl.planning.settings import parse_rig
    from rrmctl.running.deployments import Deployment, worth
    from rrmctl.store.layout import find_run, open_results

    folder = find_run(open_results(results), run)
    deployment = Deployment.of(folder, checkpoint, parse_rig(settings or ()))
    played = []
    with contextlib.closing(deployment.episodes(episodes, lambda text: tell(f"note: {text}", err=True))) as coming:
        for episode in coming:
            played.append(episode)
            if not as_json:
                tell(_line(episode))
    whole = worth(played)
    if as_json:
        about = {"run": folder.id, "task": deployment.config.task, "method": deployment.config.method}
        rig = deployment.rig.model_dump(mode="json")
        rest = {"step": deployment.step, "file": str(deployment.file), **whole, "rig": rig}
        typer.echo(plain_json({**about, **rest, "played": [asdict(episode) for episode in played]}))
    else:
        typer.echo(told(whole))


def _line(episode: Episode) -> str:
    """What came of one."""
    success, seen = ("success" if flag else "failure" for flag in (episode.success, episode.success_seen))
    parts = [f"episode {episode.number:>3}: {success}, return {episode.total:.1f}"]
    parts.append(f"by the cameras {seen}, {episode.total_seen:.1f}; error {episode.error_px:.2f} pixels")
    if episode.lost:
        parts.append(episode.lost)
    if episode.breakdowns:
        parts.append(f"breakdowns of the rig {episode.breakdowns}")
    return "; ".join(parts)


def told(worth: Mapping[str, Any]) -> str:
    """What a policy's episodes are worth together, for people."""
    return (
        "success {success:.0%} of {episodes}, 95 % interval {success_low:.0%} to {success_high:.0%}; "
        "return {return:.1f}; by the cameras {success_seen:.0%}, {return_seen:.1f}; "
        "cube lost {lost}, breakdowns {breakdowns}"
    ).format_map(worth)


def _numbers(option: str, text: str, count: int) -> list[float]:
    """As many finite numbers as an option takes, with commas between them."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise UserError(f"{option} is {text}", f"it takes {count} numbers with commas between them")
    return numbers


@deploy_app.command()
def calibrate(
    folders: Annotated[
        list[Path], typer.Argument(parser=place, metavar="FOLDER...", help="One a camera, named as the camera is.")
    ],
    out: Annotated[
        Path, typer.Option("-o", "--output", parser=place, metavar="FILE", help="Where to write it; *.json.")
    ],
    at: Annotated[
        str,
        typer.Option(
            metavar="X,Y,Z,YAW",
            help="Where the board lies in base.png: metres in the base frame of the print's top left corner, and "
            "degrees from the base's x axis to the print's rightward direction.",
        ),
    ],
    columns: Annotated[int, typer.Option(min=2, help="Squares of the board from left to right.")] = 7,
    rows: Annotated[int, typer.Option(min=2, help="And from top to bottom.")] = 5,
    square: Annotated[float, typer.Option(min=0.001, help="Metres of a square's edge, measured on the print.")] = 0.055,
    marker: Annotated[float, typer.Option(min=0.001, help="Metres of a marker's edge.")] = 0.041,
    dictionary: Annotated[str, typer.Option(help="Of the markers, by OpenCV's name.")] = "DICT_4X4_50",
) -> None:
    """Calibrate cameras from pictures of a ChArUco board, one folder of them a camera.

    Each folder has ten or more pictures of the board, near, tilted and all over the view, and `base.png`: the board
    flat on the table, print up, where the arm's tip has measured two of its corners.

      rrmctl deploy calibrate left right -o cameras.json --at 0.30,0.14,0,0
    """
    from rrm.robot.calibration import Board, Placement, calibrate_folders
    from rrmctl.store.files import storage_error

    x, y, z, yaw = _numbers("--at", at, 4)
    edge, inner = _numbers("--square and --marker", f"{square},{marker}", 2)
    board = Board(columns=columns, rows=rows, square=edge, marker=inner, dictionary=dictionary)
    calibration = calibrate_folders(folders, board, Placement(x, y, z, math.radians(yaw)))
    try:
        calibration.save(out)
    except OSError as error:
        raise storage_error(out, error) from error
    for name, camera in calibration.cameras.items():
        typer.echo(
            f"{name}: {camera.size}, {camera.pictures} pictures, reprojection error {camera.error_px:.2f} pixels, "
            f"of the board in its place {camera.base_error_px:.2f}"
        )
    typer.echo(f"{out}: calibration {calibration.digest}")
