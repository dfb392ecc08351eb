"""A robot that maps, keeps and publishes until it is killed; started again and again in one folder, killed every time.

Arguments: the folder, how often, and a seed. Run k leaves ``history-k``: a line ``session n root`` for each state
before it is kept, of all sessions there are, and a line ``published n rows`` of its own session, with the rows of its
journal, before its update n leaves. Nothing here uses threads or sockets, so that forks are safe and cheap.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from agent.keeper import Keeper
from agent.node import NoBody, Node
from agent.own_session import OwnSession
from agent.readings import Readings
from agent.team_mates import NoMates
from mapping.evidence import EvidenceModel
from mapping.lattice import Lattice
from mapping.pose import QuantisedPose
from mapping.sensor import orion
from swarm.messages import Hello
from swarm.peer import Peer
from swarm.session import Rules
from transport.in_process import Network

RULES = Rules(Lattice(50), EvidenceModel())
ORIGIN = QuantisedPose(0, 0, 0)


class Wanderer(NoBody):
    """A body that senses one scan a turn, for ever."""

    done = False

    def __init__(self, seed: int) -> None:
        super().__init__(orion())
        self._chance = np.random.default_rng(seed)
        self._n = 0

    def read(self, until: float) -> Readings:
        self._n += 1
        pose = [[self._n * 0.02 % 3, self._n * 0.007 % 1, self._n * 0.3 % 6]]
        return Readings(np.array([self._n * 100]), np.array(pose), self._chance.uniform(0.1, 1.9, (1, 5)))


class Historian(Keeper):
    """A keeper that writes down first what there is to be kept."""

    def __init__(self, folder: Path, k: int) -> None:
        super().__init__(folder, "r1", "test", RULES)
        self._history = os.open(folder / f"history-{k}", os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)

    def keep(self, peer: Peer, sessions: Sequence[OwnSession], now: float) -> None:
        lines = [
            f"{session.hex()} {replica.state.n} {replica.state.root().hex()}\n"
            for session, replica in peer.replicas.items()
        ]
        os.write(self._history, "".join(lines).encode())
        super().keep(peer, sessions, now)
        for own in sessions:
            if not own.writer.waiting:
                state = own.writer.replica.state
                os.write(self._history, f"published {state.n} {len(own.journal)}\n".encode())


def run(folder: Path, k: int) -> None:
    network = Network(seed=k)
    nodes = {}
    for robot in ("r1", "r2"):
        bus = network.bus(robot)
        keeper = Historian(folder, k) if robot == "r1" else None
        hello = Hello(Hello.ROBOT, robot.encode(), b"test")
        nodes[bus] = node = Node(bus, RULES, hello, now=0.0, body=Wanderer(k), keeper=keeper)
        node.open_session(robot, ORIGIN, "auto", NoMates(), lambda robot=robot: b"%s.%5d" % (robot.encode(), k))
    while True:
        network.advance(network.now + 0.06)
        for bus, node in nodes.items():
            node.turn(network.now, bus.receive())


def main(folder: Path, times: int, seed: int) -> None:
    chance = random.Random(seed)
    for k in range(times):
        history = folder / f"history-{k}"
        pid = os.fork()
        if pid == 0:
            try:
                run(folder, k)
            finally:  # an error is told on standard error, and by an end that is none of ours
                import traceback

                traceback.print_exc()
                os._exit(1)
        enough = chance.choice([0, 1, 1, 1000, 3000, 10_000])
        while not os.waitpid(pid, os.WNOHANG)[0] and (not history.exists() or history.stat().st_size < enough):
            time.sleep(0.001)
        time.sleep(chance.uniform(0, 0.02))
        os.kill(pid, signal.SIGKILL)
        _, status = os.waitpid(pid, 0)
        assert os.WIFSIGNALED(status), f"run {k} ended by itself"


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
