"""Something that moves about in a world and is no robot: a person's foot, a cart, a cat.

Law kept here: where it is follows from how far it has gone; who lets it go, and how far, is the simulator's business.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Shape = Literal["disc", "box"]


@dataclass(frozen=True, slots=True, eq=False)
class Obstacle:
    """A disc, or a box along the axes, that follows waypoints.

    Attributes:
        shape: disc or box.
        radius: of the disc, or half the box's side, metres.
        speed: metres a second.
        waypoints: shape (W, 2), metres; one alone is where it stands.
        loop: whether it goes on from the last waypoint to the first; otherwise it turns round there and comes back.
    """

    shape: Shape
    radius: float
    speed: float
    waypoints: NDArray[np.float64]
    loop: bool = False

    def at(self, gone: float) -> NDArray[np.float64]:
        """Its centre, shape (2,), after it has gone that many metres from its first waypoint."""
        way = np.vstack([self.waypoints, self.waypoints[:1]]) if self.loop else self.waypoints
        knots = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
        length = float(knots[-1])
        if length == 0.0:
            return np.array(self.waypoints[0])
        along = gone % length if self.loop else length - abs(length - gone % (2 * length))
        return np.array([np.interp(along, knots, way[:, 0]), np.interp(along, knots, way[:, 1])])
