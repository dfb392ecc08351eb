"""What a swarm says when there is nothing to say: digests, and few of them."""

from collections import Counter

ROBOTS = 20
SECONDS = 600.0


def test_a_quiet_swarm_of_twenty_says_less_than_20_bytes_a_second_each(swarm) -> None:
    """Trickle: all hold the same, so in each of the longest intervals two or three of them say so for all."""
    swarm.tick = 0.02
    for k in range(ROBOTS):
        swarm.robot(f"r{k}")
    swarm.drive(0.2)
    swarm.settle(5.0)
    swarm.run(30.0)  # the intervals grow
    before = spent(swarm)
    swarm.run(SECONDS)
    said = spent(swarm) - before
    assert swarm.digests() == {swarm.truth()}
    assert said.keys() == {"digest"}
    assert 0 < said.total() / ROBOTS / SECONDS < 20.0


def spent(swarm) -> Counter[str]:
    """Payload bytes that all have given to their buses, by topic."""
    return sum((peer.sent_bytes for peer in swarm.peers.values()), Counter())
