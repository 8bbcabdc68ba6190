"""Receive times of a CAN controller, brought onto the time of day."""

from __future__ import annotations

from math import inf

WINDOW_S = 0.1  # in which the shortest delay is looked for: 100 ppm are 10 µs then
LONGEST_DELAY_S = 0.01  # from the controller to the kernel; more: its clock was set


class HardwareTimes:
    """The clock of a controller counts from any moment, and drifts against that of the computer.

    The kernel sees each frame a little later than the controller: by interrupt, USB and scheduling. The least
    difference of the two stamps within the last one to two windows is that of the clocks, with the
    least delay, which is the same for all frames and stays in.
    """

    def __init__(self) -> None:
        self._ends_s = -inf  # of the window, by the clock of the controller
        self._least_s = self._before_s = inf

    def received(self, hardware_s: float, kernel_s: float) -> float:
        """When a frame with these two stamps was received, by the time of day; never after ``kernel_s``."""
        difference_s = kernel_s - hardware_s
        if hardware_s >= self._ends_s or hardware_s < self._ends_s - 2 * WINDOW_S:
            self._before_s, self._least_s = self._least_s, difference_s
            self._ends_s = hardware_s + WINDOW_S
        elif difference_s < self._least_s:
            self._least_s = difference_s
        offset_s = min(self._least_s, self._before_s)
        if difference_s - offset_s > LONGEST_DELAY_S:  # one of the clocks was set
            self._before_s = self._least_s = offset_s = difference_s
        return hardware_s + offset_s
