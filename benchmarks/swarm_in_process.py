"""The peers that ship, in one process under fake time."""

from __future__ import annotations

from collections import Counter

from benchmarks.inputs import ORION
from mapping.evidence import EvidenceModel
from mapping.lattice import Lattice
from mapping.pose import QuantisedPose
from mapping.raster import Raster
from mapping.scan import Scans
from mapping.sensor import Sensor
from swarm.messages import Hello
from swarm.peer import Peer
from swarm.radio import LAN, Profile
from swarm.session import Descriptor, Rules
from transport.bus import Bus, Joined, Left, Message
from transport.in_process import Network


class Swarm:
    """Robots r0, r1, ... that all hear each other.

    Attributes:
        sent: bytes given to the bus by each robot; to all counts once.
        said: messages given to the bus.
    """

    def __init__(
        self,
        robots: int,
        kernel: Raster,
        *,
        profile: Profile = LAN,
        sensor: Sensor = ORION,
        cell_mm: int = 20,
    ) -> None:
        self.network = Network(seed=1, delay=(0.0002, 0.001))
        self.sent: Counter[str] = Counter()
        self.said = 0
        self.peers: dict[str, Peer] = {}
        self._buses: dict[str, Bus] = {}
        rules = Rules(Lattice(cell_mm), EvidenceModel())
        for number in range(robots):
            name = f"r{number}"
            hello = Hello(Hello.ROBOT, name.encode(), b"benchmark")
            self._buses[name] = self.network.bus(name)
            peer = Peer(
                hello, rules, seed=name.encode(), mtu=self._buses[name].mtu, now=0.0, profile=profile, kernel=kernel
            )
            peer.open_session(Descriptor(name, number.to_bytes(8, "big"), rules, sensor, QuantisedPose(0, 0, 0)))
            self.peers[name] = peer

    def sense(self, robot: int, scans: Scans) -> None:
        """A robot senses."""
        writer = self.peers[f"r{robot}"].writer
        assert writer is not None
        writer.sense(scans)

    def run(self, seconds: float, *, tick: float = 0.01) -> None:
        """Let time pass; peers listen every ``tick`` at most."""
        end = self.network.now + seconds
        self._exchange()
        while self.network.now < end:
            following = self.network.next_event()
            times = [peer.wake_at for peer in self.peers.values()] + ([] if following is None else [following])
            self.network.advance(min(end, max(min(times), self.network.now + tick)))
            self._exchange()

    def agreed(self) -> bool:
        """Whether all hold the same of everybody, and nobody has more to say."""
        positions = [
            {session: replica.state.n for session, replica in peer.replicas.items()} for peer in self.peers.values()
        ]
        waiting = any(peer.writer is not None and peer.writer.waiting for peer in self.peers.values())
        return not waiting and len(positions[0]) == len(positions) and all(each == positions[0] for each in positions)

    def settle(self, seconds: float) -> float | None:
        """Seconds until all agree; None if they do not in time."""
        begin = self.network.now
        while not self.agreed():
            if self.network.now > begin + seconds:
                return None
            self.run(0.05)
        return self.network.now - begin

    def _exchange(self) -> None:
        now = self.network.now
        for name, peer in self.peers.items():
            bus = self._buses[name]
            for event in bus.receive():
                match event:
                    case Message(sender, payload):
                        peer.receive(sender, payload, now)
                    case Joined(other):
                        peer.joined(other, now)
                    case Left(other):
                        peer.left(other, now)
            for to, topic, payload in peer.poll(now):
                self.sent[name] += len(payload)
                self.said += 1
                if to is None:
                    bus.publish(topic, payload)
                else:
                    bus.send(to, payload)
