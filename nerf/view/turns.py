"""Turns: whose picture is drawn next where several browsers look. Each gets a piece in turn, so nobody starves."""

from nerf.view.picture import Picture


class Turns:
    """The newest picture of each browser."""

    def __init__(self) -> None:
        self._pictures: dict[int, Picture] = {}
        """By a browser's number; the one whose turn it is comes first."""

    def begin(self, client: int, picture: Picture) -> None:
        """Draw another picture for a browser; its older one is given up, and its turn stays."""
        self._pictures[client] = picture

    def leave(self, client: int) -> None:
        """Forget a browser."""
        self._pictures.pop(client, None)

    def picture(self, client: int) -> Picture | None:
        """Return a browser's newest picture."""
        return self._pictures.get(client)

    def next(self) -> tuple[int, Picture] | None:
        """Return a browser and its picture that is to have its next piece; None where all are whole."""
        for client, picture in self._pictures.items():
            if not picture.whole:
                self._pictures[client] = self._pictures.pop(client)  # to the end of the queue
                return client, picture
        return None
