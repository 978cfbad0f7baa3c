"""`nerf view`: a run's field, live in a browser."""

from dataclasses import dataclass
from typing import Any

from cli.arguments import parse
from cli.console import busy
from cli.nerf.arguments import RunArguments
from cli.view import AddressArguments
from nerf.view.panel import FieldPanel
from nerf.view.stage import open_stage
from priors.errors import expect_between
from priors.geometry import resize
from priors.view import server
from priors.view.scene import MOST_POINTS
from priors.view.stand import first_pose

EXAMPLES = """Look at a run's field, live in a browser: colour or depth, rendered as the camera moves, coarse to fine,
with the drive's cameras and the prior's points. Needs viser: pip install 'roadprior[view]'.

examples:
  nerf view runs/NAME
  nerf view runs/NAME --frames 10:30 --port 8090
"""
WARM = (40, 120)
"""Size of the first picture, which nobody sees: kernels are compiled with it."""


@dataclass(frozen=True)
class ViewArguments(AddressArguments, RunArguments):
    """Arguments of `nerf view`."""

    points: int = MOST_POINTS
    """Points of the prior shown at once, at most."""

    def __post_init__(self) -> None:
        AddressArguments.__post_init__(self)
        RunArguments.__post_init__(self)
        expect_between(1, self.points, 10**8, "--points")


ARGUMENTS = {"nerf view": ViewArguments}


def run(arguments: list[str]) -> int:
    """Serve the view until Ctrl-C; returns the exit code."""
    args = parse(ViewArguments, "nerf view", EXAMPLES, arguments)
    server.require()
    with args.limited():
        return _view(args, ["nerf", "view", *arguments])


def _view(args: ViewArguments, typed: list[str]) -> int:
    this_run = args.open(typed)
    model, stage = this_run.open_model(args.device), open_stage(this_run, args.frames, args.points)

    def open_panel(opened: Any) -> FieldPanel:
        panel = FieldPanel(opened, this_run.name, model.render, stage)
        pose = stage.track.unshifted(first_pose(stage.track))
        with busy("first picture"):
            panel.painter.warm(pose, resize(stage.camera, WARM))
        panel.begin()
        return panel

    return args.serve(f"nerf view {this_run.name}", open_panel)
