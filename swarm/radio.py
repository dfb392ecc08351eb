"""What the network between the peers can carry: profiles of a LAN and of slow radios, with the timers that suit each.

A radio's channel is shared: what one peer sends, no other can send meanwhile. So each peer may use the channel's rate
divided by the number of peers that are there. A packet for all takes it once, or as often as the modules repeat it.
"""

from __future__ import annotations

from dataclasses import dataclass

from swarm import timers
from swarm.limits import MAX_MESSAGE
from swarm.timers import Timers


@dataclass(frozen=True, slots=True)
class Profile:
    """One kind of network.

    Attributes:
        rate: payload bytes a second: of the channel if it is shared, else of each peer's own link.
        mtu: the longest payload, in bytes.
        update: bytes to which a writer may fill an update even if it then travels in parts.
        repeats: how often a packet for all is sent on the shared channel; 0 if the channel is not shared, and then
            every receiver is sent a copy of its own.
        burst: seconds of the own share that may be saved up while there is nothing to say.
        queue: bytes that may wait of each class, own updates excepted.
        deflate: zlib's level for tiles that are asked for. The hardest takes five times as long as the third, which
            leaves a tenth more bytes of a laser's tiles: it is for where bytes are dear.
        timers: how long peers wait.
    """

    rate: float
    mtu: int
    update: int
    repeats: int
    burst: float
    queue: int
    deflate: int
    timers: Timers

    def share(self, others: int) -> float:
        """Bytes a second that one peer may use while so many others are there."""
        return self.rate / (others + 1) if self.repeats else self.rate

    def cost(self, size: int, others: int, *, to_all: bool) -> int:
        """Bytes of the rate that a payload uses up."""
        return size * ((self.repeats or max(1, others)) if to_all else 1)


def _digimesh(bits: float) -> Profile:
    """XBee DigiMesh 2.4 (Digi 90002277): throughput falls with the hops, for each takes the channel once more.

    Nobody acknowledges a broadcast; instead each module sends it MT + 1 times (user guide, "Broadcast transmissions";
    MT is 3 from the factory). We reckon with MT = 0, to be set on the modules: what gets lost is asked for again
    anyway. The payload of 84 bytes is that of an unencrypted unicast. An update's head and a scan block's take
    some 60 bytes, so three parts (of 58 bytes, ``swarm.parts``) carry twenty scans where three updates carry ten.
    """
    return Profile(
        rate=bits / 8, mtu=84, update=3 * 58, repeats=1, burst=0.5, queue=4096, deflate=9, timers=timers.RADIO
    )


LAN = Profile(
    rate=12.5e6, mtu=MAX_MESSAGE, update=0, repeats=0, burst=0.05, queue=1 << 20, deflate=3, timers=timers.LAN
)
"""Ethernet or good Wi-Fi: 100 Mbit/s for each peer."""

PROFILES = {
    "lan": LAN,
    "digimesh-1hop": _digimesh(27_000),
    "digimesh-3hop": _digimesh(10_900),
    "digimesh-6hop": _digimesh(5_800),
}
"""By the name that the configuration gives (``radio = "digimesh-3hop"``)."""
