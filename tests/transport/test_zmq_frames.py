"""What peers say over ZeroMQ: what one says the other understands, and nothing else has an effect."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from transport.bus import Message
from transport.zmq_frames import Alive, Gone, Refused, say_alive, say_gone, say_to_all, say_to_one, understand

NAMES = st.from_regex(r"[A-Za-z0-9._-]{1,64}", fullmatch=True)


@given(swarm=NAMES, own=NAMES, other=NAMES, topic=NAMES, payload=st.binary(max_size=100))
def test_what_one_says_the_other_understands(swarm, own, other, topic, payload):
    if own == other:
        other = "another" if own != "another" else "one"
    assert understand([say_alive(swarm, own)], swarm, other, 100) == Alive(own)
    assert understand([say_gone(swarm, own)], swarm, other, 100) == Gone(own)
    assert understand([say_to_all(swarm, own, topic, payload)], swarm, other, 100) == Message(own, payload)
    assert understand([say_to_one(swarm, own, other, payload)], swarm, other, 100) == Message(own, payload)


@pytest.mark.parametrize(
    ("frames", "reason"),
    [
        ([], "malformed"),
        ([b""], "malformed"),
        ([b"orion/test/a/news"], "malformed"),
        ([b"orion/test/a/to/me"], "malformed"),
        ([b"orion/test/a/alive", b""], "malformed"),
        ([b"orion/test/a/b/c x"], "malformed"),
        ([b"orion/test//news x"], "malformed"),
        ([b"orion/test/%b/news x" % (b"a" * 65)], "malformed"),
        ([b"orion/test/\xff/news x"], "malformed"),
        ([b"orion/test/a/news\n x"], "malformed"),
        ([b"orion/other/a/news x"], "other_swarm"),
        ([b"orion/other/me/alive"], "other_swarm"),
        ([b"orion/test/me/alive"], "own_name"),
        ([b"orion/test/me/news x"], "own_name"),
        ([b"orion/test/a/to/you x"], "not_for_us"),
        ([b"orion/test/a/news " + bytes(101)], "too_long"),
        ([b"orion/test/a/to/me " + bytes(101)], "too_long"),
    ],
)
def test_what_is_not_for_us_has_a_reason(frames, reason):
    assert understand(frames, "test", "me", 100) == Refused(reason)


@given(st.lists(st.binary(max_size=40), max_size=4))
def test_noise_is_malformed(frames):
    assert understand(frames, "test", "me", 100) == Refused("malformed")
