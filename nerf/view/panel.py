"""Panel: the controls of a field's view. They are shared by all browsers; each has its own camera and picture."""

from typing import Any

from nerf.types import Render
from nerf.view import lens
from nerf.view.painter import Painter
from nerf.view.picture import Picture
from nerf.view.stage import PRIOR, Part, Stage
from priors.view import nodes
from priors.view.legend import legend
from priors.view.newest import Newest
from priors.view.panel import FAR_M, FARTHEST_M, NEAREST_M, POINT_M, escaped
from priors.view.scene import Choice
from priors.view.stand import place_first, stand_at

PART_RGB: dict[Part, tuple[int, int, int]] = {
    "trained on": (70, 150, 255),
    "held out": (255, 150, 40),
    "not used": (120, 120, 125),
}
FEWEST_PIXELS, MOST_PIXELS = 10_000, 2_000_000
COLOUR, DEPTH = "colour", "depth"
SHARP = (0.5, 1.0, 2.0, 4.0)
"""Pixels of the finished picture, as a share of those of the drive's images."""


class FieldPanel:
    """The controls of one run in one server."""

    def __init__(self, server: Any, name: str, render: Render, stage: Stage) -> None:
        self.server, self.name, self.stage = server, name, stage
        self.painter = Painter(render, self._deliver)
        self.newest: Newest[Choice | None] = Newest(self._draw_points)
        self._points: Any = None
        place_first(server, stage.track)
        colours = [PART_RGB[part] for part in stage.parts]
        self._cameras = nodes.draw_path(server, stage.track)
        self._cameras += nodes.draw_cameras(server, stage.track, stage.camera, colours)
        self._add_controls()
        self._listen()

    @property
    def fault(self) -> BaseException | None:
        """Return what ended the work behind the view, if anything did."""
        return self.painter.fault or self.newest.fault

    def begin(self) -> None:
        """Draw for whoever looks."""
        self.painter.start()
        self.server.on_client_connect(self._welcome)
        self.server.on_client_disconnect(lambda client: self.painter.leave(client.client_id))

    def close(self) -> None:
        """End the work behind the view."""
        self.painter.stop()
        self.newest.stop()

    def look(self, client: Any) -> None:
        """Draw what a browser's camera sees now."""
        camera = client.camera
        height, width = self.stage.camera.size
        pixels = min(max(height * width, FEWEST_PIXELS), MOST_PIXELS) * float(self.sharp.value)
        seen = lens.browser_camera(camera.fov, camera.aspect, round(pixels))
        self.painter.ask(
            client.client_id, lens.browser_pose(camera.wxyz, camera.position, self.stage.track.origin_m), seen
        )

    def _welcome(self, client: Any) -> None:
        """Put a new browser's camera at the frame, and follow it from then on."""
        self._jump(client)
        client.camera.on_update(lambda camera: self.look(client))
        self.look(client)

    def _deliver(self, client: int, picture: Picture) -> None:
        """Show a browser its picture."""
        found = self.server.get_clients().get(client)
        if found is not None:
            lens.show(found, picture.view(), self.kind.value == DEPTH, bool(self.hide.value))

    def _add_controls(self) -> None:
        gui, last = self.server.gui, len(self.stage.track.ids) - 1
        self.told = gui.add_markdown("")
        self.frame = gui.add_slider("frame", 0, last, 1, 0, hint="keys: N next, B back", disabled=last == 0)
        self.kind = gui.add_dropdown("picture", (COLOUR, DEPTH), initial_value=COLOUR)
        self.legend = gui.add_image(legend("depth"), format="png", visible=False)
        self.sharp = gui.add_dropdown(
            "sharpness", tuple(str(share) for share in SHARP), initial_value="1.0", hint="pixels, times the images'"
        )
        self.cameras = gui.add_checkbox("cameras", False, hint="blue: trained on, orange: held out")
        self.hide = gui.add_checkbox("surfaces hide what is behind", True)
        with gui.add_folder("the prior's points", visible=self.stage.has_points):
            self.points = gui.add_checkbox("show", False)
            self.colouring = gui.add_dropdown("colour", ("image", "depth"), initial_value="image")
            self.farthest = gui.add_slider("farthest, m", NEAREST_M, FARTHEST_M, 5, FAR_M)
            self.size = gui.add_slider("point size, m", 0.01, 0.5, 0.01, POINT_M)
        for node in self._cameras:
            node.visible = False
        self._tell()

    def _listen(self) -> None:
        self.frame.on_update(self._moved)
        self.kind.on_update(lambda _: self._switch())
        self.sharp.on_update(lambda _: self._look_again())
        self.hide.on_update(lambda _: self._show_again())
        self.cameras.on_update(lambda _: self._show_cameras())
        for control in (self.points, self.colouring, self.farthest):
            control.on_update(lambda _: self.newest.ask(self._choice()))
        self.size.on_update(lambda _: self._resize())
        for label, (key, by) in nodes.KEYS.items():
            self.server.gui.add_command(label, hotkey=key).on_trigger(lambda event, by=by: self._step(by))

    def _step(self, by: int) -> None:
        self.frame.value = min(max(int(self.frame.value) + by, 0), len(self.stage.track.ids) - 1)

    def _moved(self, event: Any) -> None:
        """Jump to the frame: the browser that moved the slider, or every one where a key did."""
        self._tell()
        clients = list(self.server.get_clients().values()) if event.client is None else [event.client]
        for client in clients:
            self._jump(client)
            self.look(client)
        if self.points.value:
            self.newest.ask(self._choice())

    def _jump(self, client: Any) -> None:
        pose = self.stage.track.pose(int(self.frame.value))
        if pose is not None:
            stand_at(client, pose, self.stage.camera)

    def _switch(self) -> None:
        self.legend.visible = self.kind.value == DEPTH
        self._show_again()

    def _show_again(self) -> None:
        """Show the pictures that are there in another way."""
        for number in self.server.get_clients():
            picture = self.painter.picture(number)
            if picture is not None:
                self._deliver(number, picture)

    def _look_again(self) -> None:
        """Draw every browser's picture anew."""
        for client in self.server.get_clients().values():
            self.look(client)

    def _show_cameras(self) -> None:
        for node in self._cameras:
            node.visible = bool(self.cameras.value)

    def _choice(self) -> Choice | None:
        if not self.points.value:
            return None
        return Choice(int(self.frame.value), 1, PRIOR, self.colouring.value, 0.0, float(self.farthest.value))

    def _draw_points(self, choice: Choice | None) -> None:
        """Draw the prior's points of the frame."""
        remarks: tuple[str, ...] = ()
        if self._points is not None:
            self._points.remove()
            self._points = None
        if choice is not None and self.stage.drive is not None:
            shown = self.stage.drive.show(choice)
            remarks = shown.remarks
            if len(shown.points):
                self._points = nodes.cloud(self.server, "/points", shown.points, float(self.size.value))
        self._tell(remarks)

    def _resize(self) -> None:
        if self._points is not None:
            self._points.point_size = float(self.size.value)

    def _tell(self, more: tuple[str, ...] = ()) -> None:
        """Say in Markdown what is seen."""
        track, place = self.stage.track, int(self.frame.value)
        lines = [f"**{escaped(self.name)}**"]
        frame = f"frame {escaped(track.ids[place])}, {place + 1} of {len(track.ids)}: {self.stage.parts[place]}"
        lines.append(frame)
        if track.far():
            lines.append("origin: " + ", ".join(f"{value:.1f}" for value in track.origin_m) + " m")
        lines += [f"*{escaped(remark)}*" for remark in (*self.stage.remarks, *more)]
        self.told.content = "\n\n".join(lines)
