"""How a simulation is held at its rate of simulated seconds per second of real time. Used by ros_bridge.py."""

from __future__ import annotations

import time
from typing import Callable


class RealTimeRate:
    """Keeps simulated and wall time in step.

    Args:
        warn: is called with a line, at most every 10 s, when this machine is too slow for the rate.
    """

    def __init__(self, warn: Callable[[str], None]):
        self.warn = warn
        self.late, self._reported = 0.0, 0.0
        self.begin()

    def begin(self) -> None:
        """Count time from now on."""
        self.next = time.monotonic()

    def wait(self, simulated: float, factor: float, report: bool = True) -> None:
        """Sleep until wall time has caught up; a delay of more than .2 s is given up and reported."""
        now = time.monotonic()
        self.next += simulated / factor
        if self.next > now:
            time.sleep(self.next - now)
        elif now - self.next > 0.2:
            self.late += now - self.next
            self.next = now
            if report and now - self._reported > 10.0:
                self._reported = now
                self.warn(
                    f"{self.late:.1f} s lost so far: real_time_factor {factor:g} is too much for this machine now"
                )
