"""The exchange in docs/protocol.md, section 17, is what the code says."""

import re
from pathlib import Path

from swarm.messages import Digest, Hello, Manifest, Need, Session, TilesMessage, Update, Want, decode
from swarm.session import Descriptor
from swarm.tile_block import decode_tiles
from transport.in_process import Network

DOCUMENT = Path(__file__).parents[2] / "docs" / "protocol.md"


class Said(list):
    """What was said, and when in milliseconds since ``began``."""

    def __init__(self, network):
        super().__init__()
        self.network = network
        self.began = network.now
        self.times = []

    def append(self, each):
        super().append(each)
        self.times.append(1000 * (self.network.now - self.began))


def test_the_documented_exchange_is_what_the_code_says(make_swarm, scans):
    swarm = make_swarm(Network(seed=1, delay=(0.002, 0.002)))
    swarm.robot("r1")
    swarm.robot("r2")
    for n in range(43):
        swarm.sense("r1", scans(n, 2))
        swarm.run(0.1)
    swarm.sense("r2", scans(100, 2))
    swarm.run(1.0)
    swarm.crash("r1")
    swarm.run(30.0)

    swarm.said = Said(swarm.network)
    observer = swarm.observer("o")
    swarm.settle(1.0)
    table = [
        f"| {ms:.1f} | {sender} | {to or 'all'} | {in_words(decode(payload))} | {len(payload)} |"
        for ms, (sender, to, payload) in zip(swarm.said.times, swarm.said, strict=True)
    ]
    document = DOCUMENT.read_text()
    assert without_deflated_sizes("\n".join(table)) in without_deflated_sizes(document)
    assert f"`{observer.fusion.digest().hex()}`" in document


def without_deflated_sizes(text):
    """Not every build of zlib finds the same bytes."""
    return re.sub(r"(tiles of r\d: \d+), \d+ B \| \d+", r"\1", text)


def in_words(message):
    match message:
        case Hello(role, name):
            words = f"hello: {'robot' if role == Hello.ROBOT else 'observer'} {name.decode()}"
        case Digest():
            held = [f"{robot(session)} at {n}" for session, n in message.positions().items()]
            words = f"digest: {', '.join(held) or 'nothing'}"
        case Session(descriptor):
            words = f"session of {Descriptor.decode(descriptor).robot}"
        case Update(session, n, Update.SCANS, payload):
            words = f"update of {robot(session)}, n = {n}, {len(payload)} B of scans"
        case Want(session, n, through):
            words = f"want {robot(session)}: have n = {n}, through = {through}"
        case Manifest(session, n, since):
            words = f"manifest of {robot(session)}: n = {n}, since = {since}, {len(message.marks())} tiles"
        case Need(session, n, since):
            words = f"need {robot(session)}: n = {n}, since = {since}, {len(list(message.wanted()))} tiles"
        case TilesMessage(session, payload):
            words = f"tiles of {robot(session)}: {len(decode_tiles(payload))}, {len(payload)} B"
        case _:
            raise AssertionError(message)
    return words


def robot(session):
    return session[:2].decode()
