"""Ways to merge what robots know, on the same noisy data: how wrong the maps are, and where peers disagree.

Four robots see cells of 200 x 200 at random; each sighting is wrong with a chance of 15 %, and messages
reach every peer in another order. Wrong is a cell that is seen and called the other thing than it is; disagreement is a
cell that not all peers call the same.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.table import Row
from mapping.evidence import EvidenceModel, occupied

_ROBOTS, _SIDE, _ROUNDS, _NOISE = 4, 200, 5, 0.15
Grid = NDArray[Any]


def measure() -> list[Row]:
    """Percent of the cells seen, the mean over peers and five seeds."""
    errors = [_run(seed) for seed in range(5)]
    rows = []
    for rule in errors[0]:
        wrong = [run[rule][0] for run in errors]
        apart = [run[rule][1] for run in errors]
        rows.append(Row(f"{rule}: wrong", float(np.median(wrong)), "%", min(wrong), max(wrong)))
        rows.append(Row(f"{rule}: peers disagree", float(np.median(apart)), "%", min(apart), max(apart)))
    return rows


def _run(seed: int) -> dict[str, tuple[float, float]]:
    chance = np.random.default_rng(seed)
    truth = chance.random((_SIDE, _SIDE)) < 0.3
    model = EvidenceModel()
    own = np.zeros((_ROBOTS, _SIDE, _SIDE), np.int64)  # each robot's evidence
    stamp = np.zeros((_ROBOTS, _SIDE, _SIDE), np.int64)  # and when it last saw a cell
    overwritten = np.zeros_like(own)  # each peer's map if a message replaces what it had
    remote = np.zeros_like(own)  # each peer's last word of others
    for turn in range(1, _ROUNDS + 1):
        for robot in chance.permutation(_ROBOTS):
            seen = chance.random(truth.shape) < 0.25
            called = truth ^ (chance.random(truth.shape) < _NOISE)
            own[robot][seen] += np.where(called, model.occupied, model.free)[seen]
            overwritten[robot][seen] += np.where(called, model.occupied, model.free)[seen]
            stamp[robot][seen] = turn * _ROBOTS + robot
        before, told = overwritten.copy(), own.copy()
        for peer in range(_ROBOTS):
            for sender in chance.permutation(_ROBOTS):
                if peer != sender:
                    fresh = stamp[sender] > (turn - 1) * _ROBOTS + _ROBOTS - 1
                    overwritten[peer][fresh] = before[sender][fresh]
                    remote[peer][fresh] = told[sender][fresh]
    known = np.where(stamp > 0, own, np.iinfo(np.int64).min)
    newest = np.take_along_axis(own, stamp.argmax(axis=0)[None], axis=0)[0]
    everyone = np.ones(_ROBOTS, bool)[:, None, None]
    maps = {
        "maximum": np.where(everyone, known.max(axis=0), 0),
        "own cell wins, else the last remote": np.where(own != 0, own, remote),
        "remote overwrites": overwritten,
        "last writer wins": np.where(everyone, newest, 0),
        "sum of single writers": np.where(everyone, own.sum(axis=0), 0),
    }
    visited = (stamp > 0).any(axis=0)
    result = {}
    for rule, each in maps.items():
        called = occupied(each)
        wrong = (called != truth)[:, visited].mean() * 100
        apart = (called != called[0]).any(axis=0)[visited].mean() * 100
        result[rule] = (float(wrong), float(apart))
    return result
