"""Whole swarms in one process under fake time: the peers that ship, on the in-process bus."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from mapping.evidence import EvidenceModel
from mapping.integrate import integrated
from mapping.lattice import Cells, Lattice, TileKey
from mapping.pose import QuantisedPose
from mapping.scan import INVALID, NO_RETURN, Scans
from mapping.sensor import Sensor, orion
from mapping.tiles import map_digest, summed
from swarm.messages import Hello, Message, Part, decode
from swarm.peer import Peer
from swarm.radio import LAN, Profile
from swarm.session import Descriptor, Rules
from swarm.writer import Publish
from transport.bus import Bus, Joined, Left
from transport.bus import Message as Heard
from transport.in_process import Network

RULES = Rules(Lattice(50), EvidenceModel())
ORION = orion()


def random_scans(seed: int, count: int, sensor: Sensor = ORION, *, stride: int = 60) -> Scans:
    """A robot that wanders about at random, up to ``stride`` mm a scan on each axis: a valid batch of scans."""
    chance = np.random.default_rng(seed)
    walk = np.cumsum(chance.integers(-stride, stride + 1, (count, 2)), axis=0)
    poses = np.column_stack([walk, chance.integers(0, 65536, count)]).astype(np.int32)
    ranges = chance.integers(1, sensor.max_range_mm + 1, (count, len(sensor.beams)))
    kind = chance.random(ranges.shape)
    ranges[kind < 0.1] = NO_RETURN
    ranges[kind > 0.95] = INVALID
    return Scans(np.arange(count, dtype=np.int64) * 100, poses, ranges.astype(np.uint16))


@dataclass
class Swarm:
    """Peers on one network; ``run`` lets time pass.

    Attributes:
        tick: how long peers are busy before they listen again; makes large swarms much faster to run.
        journals: each session's descriptor and the scans that decide its map.
        said: everything that was given to the buses: who, to whom (None: all), payload.
        evicted: the sessions that are out of the true map.
    """

    network: Network
    profile: Profile = LAN
    rules: Rules = RULES
    mtu: int = 32768
    tick: float = 0.0
    peers: dict[str, Peer] = field(default_factory=dict)
    buses: dict[str, Bus] = field(default_factory=dict)
    journals: dict[str, tuple[Descriptor, list[Scans]]] = field(default_factory=dict)
    said: list[tuple[str, str | None, bytes]] = field(default_factory=list)
    evicted: set[bytes] = field(default_factory=set)

    def observer(self, name: str, rules: Rules | None = None) -> Peer:
        """A peer that only follows."""
        return self._join(name, Hello(Hello.OBSERVER, name.encode(), b"test"), rules or self.rules)

    def robot(
        self,
        name: str,
        *,
        robot: str | None = None,
        session: bytes | None = None,
        publish: Publish = "auto",
        rules: Rules | None = None,
        sensor: Sensor = ORION,
        start: QuantisedPose | None = QuantisedPose(0, 0, 0),  # noqa: B008 - a constant
    ) -> Peer:
        """A peer that writes a session."""
        rules = rules or self.rules
        peer = self._join(name, Hello(Hello.ROBOT, name.encode(), b"test"), rules)
        descriptor = Descriptor(robot or name, session or (name.encode() * 8)[:8], rules, sensor, start)
        peer.open_session(descriptor, publish)
        self.journals[name] = descriptor, []
        return peer

    def _join(self, name: str, hello: Hello, rules: Rules) -> Peer:
        self.buses[name] = self.network.bus(name)
        self.peers[name] = Peer(
            hello, rules, seed=name.encode(), mtu=self.mtu, now=self.network.now, profile=self.profile
        )
        return self.peers[name]

    def sense(self, name: str, scans: Scans) -> None:
        """A robot senses; kept so that the truth is known."""
        writer = self.peers[name].writer
        assert writer is not None
        writer.sense(scans)
        self.journals[name][1].append(scans)

    def correct(self, name: str, scans: Scans) -> None:
        """A robot learns that its scans should have been these: it corrects its map, and so does the truth."""
        peer, (descriptor, journal) = self.peers[name], self.journals[name]
        assert peer.writer is not None
        after = integrated({}, scans, descriptor.sensor, descriptor.rules.model, descriptor.rules.lattice)
        gone = {key: np.zeros_like(cells) for key, cells in peer.writer.replica.state.cells.items()}
        peer.correct(gone | after, self.network.now)
        journal[:] = [scans]

    def replace(self, name: str, session: bytes, x_mm: int, y_mm: int) -> None:
        """A robot learns that it started elsewhere: it opens its session anew with all of its scans moved."""
        peer, (old, journal) = self.peers[name], self.journals[name]
        place = QuantisedPose(x_mm, y_mm, 0)
        descriptor = replace(old, session=session, start=place, replaces=old.session)
        shift = np.array([x_mm - (old.start.x_mm if old.start else 0), y_mm - (old.start.y_mm if old.start else 0), 0])
        moved = [Scans(each.stamps_ms, each.poses + shift.astype(np.int32), each.ranges) for each in journal]
        peer.open_session(descriptor).sense(Scans.join(moved))
        self.journals[name] = descriptor, moved

    def evict(self, name: str, session: bytes) -> None:
        """Somebody decides that a session is wrong."""
        self.peers[name].evict(session, self.network.now)
        self.evicted.add(session)

    def readmit(self, name: str, session: bytes) -> None:
        """Somebody decides that it was not."""
        self.peers[name].readmit(session, self.network.now)
        self.evicted.discard(session)

    def drive(self, seconds: float, *, every: float = 0.1, scans: int = 1, seed: int = 0, stride: int = 60) -> None:
        """All robots drive about, sense and publish."""
        for step in range(round(seconds / every)):
            for k, name in enumerate([name for name in self.journals if name in self.peers]):
                self.sense(name, random_scans(1000 * seed + 100 * step + k, scans, self.sensor(name), stride=stride))
            self.run(every)

    def sensor(self, name: str) -> Sensor:
        """What a robot senses with."""
        return self.journals[name][0].sensor

    def crash(self, name: str) -> None:
        """A process is killed."""
        self.network.crash(name)
        del self.peers[name], self.buses[name]

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> float:
        """Let time pass; gives how much did."""
        begin, end = self.network.now, self.network.now + seconds
        self._exchange()
        while not until():
            times = [peer.wake_at for peer in self.peers.values()]
            following = self.network.next_event()
            now = min([*times, end if following is None else following])
            if now >= end:
                self.network.advance(end)
                self._exchange()
                break
            self.network.advance(min(end, max(now, self.network.now + self.tick)))
            self._exchange()
        return self.network.now - begin

    def _exchange(self) -> None:
        now = self.network.now
        for name, peer in self.peers.items():
            bus = self.buses[name]
            for event in bus.receive():
                match event:
                    case Heard(sender, payload):
                        peer.receive(sender, payload, now)
                    case Joined(other):
                        peer.joined(other, now)
                    case Left(other):
                        peer.left(other, now)
            for to, topic, payload in peer.poll(now):
                self.said.append((name, to, payload))
                if to is None:
                    bus.publish(topic, payload)
                else:
                    bus.send(to, payload)

    def messages(self, kind: type[Message], name: str | None = None) -> Iterator[Message]:
        """The messages of one kind that somebody said, whole ones only."""
        for sender, _, payload in self.said:
            message = decode(payload)
            if isinstance(message, kind) and name in {None, sender}:
                yield message

    def parts(self) -> int:
        """How many parts of long messages were said."""
        return sum(isinstance(decode(payload), Part) for _, _, payload in self.said)

    def digests(self) -> set[bytes]:
        """The different maps that peers have: one, if they agree."""
        return {peer.fusion.digest() for peer in self.peers.values()}

    def agree(self) -> bool:
        """Whether all peers are at the same n everywhere and have one map."""
        positions = [
            {session: replica.state.n for session, replica in peer.replicas.items()} for peer in self.peers.values()
        ]
        controls = {peer.controls.check for peer in self.peers.values()}
        waiting = any(peer.writer is not None and peer.writer.waiting for peer in self.peers.values())
        return (
            not waiting
            and len(controls) == 1
            and all(each == positions[0] for each in positions)
            and len(self.digests()) == 1
        )

    def truth(self) -> bytes:
        """The digest of the sum of all robots' scans, made without any network, in one go."""
        maps: list[dict[TileKey, Cells]] = []
        for descriptor, batches in self.journals.values():
            if descriptor.start is not None and batches and descriptor.session not in self.evicted:
                scans, rules = Scans.join(batches), descriptor.rules
                maps.append(integrated({}, scans, descriptor.sensor, rules.model, rules.lattice))
        return map_digest(summed(maps))

    def settle(self, seconds: float) -> float:
        """Let time pass until all agree, at most so long; gives how long it took. All maps must then be the truth."""
        begin = self.network.now
        while not self.agree():  # to know is much work, so it is not asked after every message
            assert self.network.now < begin + seconds, f"no agreement after {seconds} s"
            self.run(0.02)
        took = self.network.now - begin
        assert self.digests() == {self.truth()}
        assert all(replica.state.sound() for peer in self.peers.values() for replica in peer.replicas.values())
        return took


@pytest.fixture
def swarm() -> Swarm:
    """A swarm on a network without faults."""
    return Swarm(Network(seed=1, delay=(0.0002, 0.001)))


@pytest.fixture
def make_swarm() -> type[Swarm]:
    """To make a swarm on a network of one's own."""
    return Swarm


@pytest.fixture
def scans() -> Callable[..., Scans]:
    """``random_scans``."""
    return random_scans
