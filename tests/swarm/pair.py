"""Peers that hear each other at once, without a network, and what they are given to sense."""

from collections import deque

import numpy as np

from mapping.evidence import EvidenceModel
from mapping.integrate import integrated
from mapping.lattice import Lattice
from mapping.pose import QuantisedPose
from mapping.scan import Scans
from mapping.sensor import orion
from mapping.tiles import frozen, map_digest
from swarm.messages import Hello
from swarm.peer import Peer
from swarm.session import Descriptor, Rules

RULES = Rules(Lattice(50), EvidenceModel())
OTHER_RULES = Rules(Lattice(20), EvidenceModel())
ORION = orion()
START = QuantisedPose(0, 0, 0)
SESSION = b"a......."


def some_scans(seed, count):
    chance = np.random.default_rng(seed)
    poses = np.column_stack([np.cumsum(chance.integers(-40, 60, (count, 2)), axis=0), chance.integers(0, 65536, count)])
    ranges = chance.integers(0, 801, (count, 5))
    return Scans(np.arange(count, dtype=np.int64) * 100, poses.astype(np.int32), ranges.astype(np.uint16))


class Pair:
    """Peers by name, a clock, and messages that travel when they are told to."""

    def __init__(self, mtu=32768):
        self.now = 0.0
        self.mtu = mtu
        self.peers = {}
        self.traffic = []

    def observer(self, name, rules=RULES, **more):
        hello = Hello(Hello.OBSERVER, name.encode(), b"test")
        self.peers[name] = Peer(hello, rules, seed=name.encode(), mtu=self.mtu, now=self.now, **more)
        return self.peers[name]

    def robot(self, name, rules=RULES, start=START, publish="auto"):
        peer = self.observer(name, rules)
        peer.open_session(Descriptor(name, name.encode().ljust(8, b"."), rules, ORION, start), publish)
        return peer

    def run(self, seconds):
        """Deliver everything, as often as somebody wants to speak."""
        end = self.now + seconds
        while True:
            queue = deque()
            for name, peer in self.peers.items():
                queue += [(name, each) for each in peer.poll(self.now)]
            for name, each in queue:
                self.traffic.append((name, each))
                for other, peer in self.peers.items():
                    if other != name and each.to in {None, other}:
                        peer.receive(name, each.payload, self.now)
            following = max(self.now, min(peer.wake_at for peer in self.peers.values()))
            if not queue and following > end:
                self.now = end
                return
            if not queue:
                self.now = following

    def digests(self):
        return {peer.fusion.digest() for peer in self.peers.values()}


def truth(*batches):
    tiles = {}
    for scans in batches:
        tiles |= integrated(tiles, scans, ORION, RULES.model, RULES.lattice)
    return map_digest(tiles)


def snapshot(peer):
    """All that a peer believes about maps."""
    return (
        peer.fusion.digest(),
        {session: (replica.state.n, replica.state.root()) for session, replica in peer.replicas.items()},
        dict(peer.refused),
        dict(peer.replaced),
        [*peer.controls],
    )


def damaged(peer, session, key=None):
    """Flip a bit of one tile in memory."""
    cells = peer.replicas[session].state.cells
    key = key or min(cells)
    wrong = cells[key].copy()
    wrong[5, 5] ^= 64
    cells[key] = frozen(wrong)


def following():
    """An observer that follows a robot, and the robot."""
    pair = Pair()
    a, o = pair.robot("a"), pair.observer("o")
    a.writer.sense(some_scans(1, 3))
    pair.run(1.0)
    return pair, a, o
