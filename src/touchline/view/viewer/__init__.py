"""An interactive view of a run: the Rerun viewer, fed frame by frame."""

from touchline.view.viewer.run_view import RunView
from touchline.view.viewer.screen import Screen, open_screen
from touchline.view.viewer.watching import LatestShown, watch, watch_robot

__all__ = ["LatestShown", "RunView", "Screen", "open_screen", "watch", "watch_robot"]
