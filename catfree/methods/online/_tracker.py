"""`Tracker`: people on the ground while the video runs."""

from collections.abc import Iterable

from catfree.methods.online._tracker_state import TrackerState
from catfree.methods.online._update import Update
from catfree.settings import Settings
from catfree.types import Detections, Scene


class Tracker:
    """Track people instant by instant: positions of now, and final ones of `time - lag`.

    There are no threads and no clock inside: time is that of the data.

    Args:
        scene: cameras and ground, as for `localize`.
        settings: `Settings()` if None; the method must be "evidence".
        lag: seconds after which positions are final; 0 for at once, `math.inf` for at `finish`,
            which then returns what `localize` does.
        frame_rate: usual number of instants per second; learned from the times if None.
    """

    def __init__(
        self,
        scene: Scene,
        settings: Settings | None = None,
        *,
        lag: float = 2.0,
        frame_rate: float | None = None,
    ) -> None:
        raise NotImplementedError

    def update(
        self, detections: Detections, time: float, cameras: Iterable[int] | None = None
    ) -> Update:
        """Add one instant.

        Args:
            detections: the boxes of one instant, of all cameras, in any order; their frame numbers
                and clock are not used.
            time: seconds; later than that of the call before.
            cameras: indices of the cameras that delivered a picture, with people or without; all
                if None. Nothing is concluded from the silence of the others.

        Returns:
            Positions of this instant, and those of all instants that are `lag` old.
        """
        raise NotImplementedError

    def finish(self) -> Update:
        """Make all positions final; then only `reset` continues."""
        raise NotImplementedError

    def reset(self) -> None:
        """Forget everything, also what was learned about the cameras."""
        raise NotImplementedError

    @property
    def state(self) -> TrackerState:
        """All that the tracker remembers; set it to continue from there."""
        raise NotImplementedError

    @state.setter
    def state(self, state: TrackerState) -> None:
        raise NotImplementedError
