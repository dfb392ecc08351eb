"""Evidence: log-odds as integers, one unit is 0.01 nat, so that sums are exact in any order.

The inverse sensor model (algorithm 2) gives every cell of a ray one of two values; a map is the sum of them
(algorithm 1, eq. 5 and 6, with the prior l_0 = 0). Probability exists only on reading (eq. 7).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

UNITS_PER_NAT = 100
OCCUPIED_PROBABILITY = 0.65
"""A cell is called occupied when its probability exceeds this (nav2's and map_server's customary threshold)."""

_LIMIT = 10_000


def to_units(nats: float) -> int:
    """Log-odds in nats as integer evidence."""
    return round(nats * UNITS_PER_NAT)


def probability(evidence: NDArray[np.int32]) -> NDArray[np.float64]:
    """Eq. 7 in its right form, p = 1 - 1 / (1 + exp l).

    The paper prints 1 - 1 / (1 - exp l): a misprint, which has a pole at l = 0 where p must be 0.5.
    """
    log_odds = evidence / UNITS_PER_NAT
    with np.errstate(over="ignore"):
        return np.asarray(1.0 - 1.0 / (1.0 + np.exp(log_odds)), dtype=np.float64)


def occupied(evidence: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Where the probability exceeds 0.65: a plain threshold on the integer (62 units)."""
    odds = math.log(OCCUPIED_PROBABILITY / (1 - OCCUPIED_PROBABILITY))
    return np.asarray(evidence > odds * UNITS_PER_NAT)


@dataclass(frozen=True, slots=True)
class EvidenceModel:
    """What a reading is worth; one for the whole swarm.

    Attributes:
        occupied: units added to the cell of a reading (l_occ).
        free: units added to every cell before it (l_free).
        limit: 0, or the bound that each cell of one session is held within after every scan, so that a map of a
            place that changes can change too. It acts on a session's own cells, never on the sum over sessions.

    Raises:
        ValueError: occupied is not positive, free not negative, or the limit is negative.
    """

    occupied: int = 85
    free: int = -40
    limit: int = 0

    def __post_init__(self) -> None:
        if not 0 < self.occupied <= _LIMIT:
            raise ValueError(f"evidence: occupied is {self.occupied}, expected 1 to {_LIMIT} units of 0.01 nat")
        if not -_LIMIT <= self.free < 0:
            raise ValueError(f"evidence: free is {self.free}, expected {-_LIMIT} to -1 units of 0.01 nat")
        if not 0 <= self.limit <= _LIMIT:
            raise ValueError(f"evidence: limit is {self.limit}, expected 0 (none) to {_LIMIT} units of 0.01 nat")
