"""Panel: the controls of a drive's view, and what they change. All browsers that look at it share them."""

from functools import partial
from typing import Any, get_args

from priors.errors import DataError
from priors.view import nodes
from priors.view.cloud import Colouring
from priors.view.legend import legend
from priors.view.newest import Newest
from priors.view.scene import Choice, DriveScene, Shown, spread
from priors.view.stand import place_first, stand_at

NONE = "none"
IMAGES = 8
"""Images that are shown at once; of more frames every n-th."""
MOST_TOGETHER = 100
NEAREST_M, FARTHEST_M, FAR_M = 5, 250, 80
POINT_M = 0.05


class DrivePanel:
    """The controls of one drive in one server."""

    def __init__(self, server: Any, scene: DriveScene) -> None:
        self.server, self.scene = server, scene
        self.shown: Shown | None = None
        """What is on the screen."""
        self._clouds: dict[str, Any] = {}
        self._frustums: list[Any] = []
        place_first(server, scene.track)
        self._path = nodes.draw_path(server, scene.track) + nodes.draw_cameras(
            server, scene.track, scene.frame(0).camera
        )
        self._add_controls()
        self.newest: Newest[Choice] = Newest(self.draw)
        self._listen()
        self.newest.ask(self.choice())

    @property
    def fault(self) -> BaseException | None:
        """Return what ended the work behind the view, if anything did."""
        return self.newest.fault

    def close(self) -> None:
        """End the work behind the view."""
        self.newest.stop()

    def choice(self) -> Choice:
        """Return what the controls say."""
        return Choice(
            position=int(self.frame.value),
            together=int(self.together.value),
            prior=None if self.prior.value == NONE else str(self.prior.value),
            colouring=self.colouring.value,
            least_confidence=float(self.confidence.value),
            farthest_m=float(self.farthest.value),
            sweeps=bool(self.sweeps.value),
        )

    def draw(self, choice: Choice) -> None:
        """Draw a choice."""
        self.shown = self.scene.show(choice)
        remarks = list(self.shown.remarks)
        with self.server.atomic():
            for name, points in (("points", self.shown.points), ("sweeps", self.shown.sweeps)):
                if name in self._clouds:
                    self._clouds.pop(name).remove()
                if len(points):
                    self._clouds[name] = nodes.cloud(self.server, f"/{name}", points, self._point_m(name))
            remarks += self._draw_images(choice)
            self.told.content = self._tell(choice, self.shown, remarks)
            self._show_legend(choice)

    def _point_m(self, name: str) -> float:
        """Return a point's size; a sweep's are smaller, so that what lies under them is seen."""
        return float(self.size.value) * (0.6 if name == "sweeps" else 1.0)

    def _add_controls(self) -> None:
        gui, last = self.server.gui, len(self.scene.indices) - 1
        posed = self.scene.track.posed
        self.told = gui.add_markdown("")
        self.frame = gui.add_slider("frame", 0, last, 1, 0, hint="keys: N next, B back", disabled=last == 0)
        self.together = gui.add_slider(
            "frames at once", 1, max(1, min(last + 1, MOST_TOGETHER)), 1, 1, disabled=not posed or last == 0
        )
        self.stand = gui.add_button("stand where this frame's camera was", visible=posed)
        names = [*self.scene.priors, NONE] if self.scene.priors else [NONE]
        there = bool(self.scene.priors)
        with gui.add_folder("points", visible=there or "sweep" in self.scene.has):
            self.prior = gui.add_dropdown("prior", names, initial_value=names[0], visible=there)
            self.colouring = gui.add_dropdown("colour", self._colourings(), initial_value="image", visible=there)
            self.legend = gui.add_image(legend("depth"), format="png", visible=False)
            self.confidence = gui.add_slider("least confidence", 0.0, 1.0, 0.01, 0.0, visible=there)
            self.farthest = gui.add_slider("farthest, m", NEAREST_M, FARTHEST_M, 5, FAR_M, visible=there)
            self.size = gui.add_slider("point size, m", 0.01, 0.5, 0.01, POINT_M)
            self.sweeps = gui.add_checkbox("LiDAR sweep", not there and "sweep" in self.scene.has)
            self.sweeps.visible = "sweep" in self.scene.has
        with gui.add_folder("drive"):
            self.images = gui.add_checkbox("images", True)
            self.path = gui.add_checkbox("path and cameras", True, visible=posed)

    def _colourings(self) -> list[Colouring]:
        """Return the colourings that something here has."""
        sure = any((prior.folder / "confidence").is_dir() for prior in self.scene.priors.values())
        lacking = {"error": "truth" not in self.scene.has, "confidence": not sure}
        return [each for each in get_args(Colouring) if not lacking.get(each, False)]

    def _listen(self) -> None:
        asking = (self.frame, self.together, self.prior, self.colouring, self.confidence, self.farthest)
        for control in (*asking, self.sweeps, self.images):
            control.on_update(lambda _: self.newest.ask(self.choice()))
        self.size.on_update(lambda _: self._resize())
        self.path.on_update(lambda _: self._show_path())
        self.stand.on_click(lambda event: self._stand(event.client))
        for label, (key, by) in nodes.KEYS.items():
            self.server.gui.add_command(label, hotkey=key).on_trigger(partial(self._step, by))

    def _step(self, by: int, event: Any) -> None:
        self.frame.value = min(max(int(self.frame.value) + by, 0), len(self.scene.indices) - 1)

    def _resize(self) -> None:
        for name, node in list(self._clouds.items()):
            node.point_size = self._point_m(name)

    def _show_path(self) -> None:
        for node in self._path:
            node.visible = bool(self.path.value)

    def _stand(self, client: Any) -> None:
        """Stand at the frame's camera; the images would cover what lies behind them, so they go."""
        pose = self.scene.track.pose(int(self.frame.value))
        if client is not None and pose is not None:
            self.images.value = False
            stand_at(client, pose, self.scene.frame(int(self.frame.value)).camera)

    def _draw_images(self, choice: Choice) -> list[str]:
        """Draw the images of the frames that are shown; returns why some are not there."""
        remarks, together = [], self.scene.together(choice)
        for node in self._frustums:
            node.remove()
        self._frustums = []
        for place in spread(len(together), IMAGES) if self.images.value else ():
            position = together[place]
            pose = self.scene.track.pose(position)
            try:
                if pose is not None:
                    image, camera = self.scene.thumbnail(position), self.scene.frame(position).camera
                    name = f"/images/{place}"
                    self._frustums.append(nodes.frustum(self.server, name, pose, camera, nodes.IMAGE_RGB, image))
            except DataError as error:
                remarks.append(str(error))
        return remarks

    def _show_legend(self, choice: Choice) -> None:
        picture = legend(choice.colouring) if choice.prior is not None else None
        self.legend.visible = picture is not None
        if picture is not None:
            self.legend.image = picture

    def _tell(self, choice: Choice, shown: Shown, remarks: list[str]) -> str:
        """Say in Markdown what is seen."""
        track, together = self.scene.track, self.scene.together(choice)
        lines = [f"**{escaped(self.scene.drive.name)}**"]
        last = "" if len(together) == 1 else f" to {escaped(track.ids[together[-1]])}"
        lines.append(f"frame {escaped(track.ids[choice.position])}{last}, {together[0] + 1} of {len(track.ids)}")
        lines += [shown.caption()] if shown.caption() else []
        if not track.posed:
            lines.append("no poses: one frame at a time, each at the origin")
        elif track.far():
            lines.append("origin: " + ", ".join(f"{value:.1f}" for value in track.origin_m) + " m")
        lines += [f"*{escaped(remark)}*" for remark in dict.fromkeys(remarks[:IMAGES])]
        return "\n\n".join(lines)


def escaped(text: str) -> str:
    """Return a name as it is, for Markdown."""
    return "".join(f"\\{letter}" if letter in r"\`*_{}[]<>()#+-.!|~$" else letter for letter in text)
