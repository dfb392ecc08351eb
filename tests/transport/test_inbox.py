"""The bounded queue by itself."""

from __future__ import annotations

import threading
import time
from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from transport.bus import Event, Joined, Left, Message
from transport.inbox import Inbox

events = st.one_of(
    st.builds(Message, sender=st.sampled_from("ab"), payload=st.binary(max_size=20)),
    st.builds(Joined, peer=st.sampled_from("ab")),
    st.builds(Left, peer=st.sampled_from("ab")),
)


def inbox_of(*put: Event, **limits: int) -> tuple[Inbox, Counter[str]]:
    counters: Counter[str] = Counter()
    inbox = Inbox(counters, **limits)
    for event in put:
        inbox.put(event)
    return inbox, counters


@given(put=st.lists(events))
def test_what_fits_comes_out_as_it_went_in(put):
    inbox, counters = inbox_of(*put)
    assert inbox.take() == put
    assert inbox.take() == []
    assert counters["received"] == sum(isinstance(event, Message) for event in put)
    assert counters["dropped_inbox_full"] == 0


@given(put=st.lists(events), max_messages=st.integers(0, 10), max_bytes=st.integers(0, 100))
def test_whatever_is_put_the_limits_hold_and_nothing_goes_uncounted(put, max_messages, max_bytes):
    inbox, counters = inbox_of(*put, max_messages=max_messages, max_bytes=max_bytes)
    taken = inbox.take()
    messages = [event for event in taken if isinstance(event, Message)]
    all_messages = [event for event in put if isinstance(event, Message)]
    assert len(messages) <= max_messages
    assert sum(len(message.payload) for message in messages) <= max_bytes
    assert messages == all_messages[len(all_messages) - len(messages) :]
    assert counters["received"] == len(all_messages)
    assert counters["bytes_received"] == sum(len(message.payload) for message in all_messages)
    assert counters["dropped_inbox_full"] == len(all_messages) - len(messages)


@given(put=st.lists(events), max_messages=st.integers(0, 3))
def test_presence_is_never_dropped(put, max_messages):
    inbox, _ = inbox_of(*put, max_messages=max_messages)
    assert [e for e in inbox.take() if not isinstance(e, Message)] == [e for e in put if not isinstance(e, Message)]


def test_room_is_made_again_by_taking():
    inbox, counters = inbox_of(Message("a", b"12345"), max_bytes=5)
    inbox.take()
    inbox.put(Message("a", b"67890"))
    assert inbox.take() == [Message("a", b"67890")]
    assert counters["dropped_inbox_full"] == 0


def test_an_empty_inbox_is_waited_for_no_longer_than_asked():
    inbox, _ = inbox_of()
    before = time.monotonic()
    assert inbox.take(0.02) == []
    assert 0.02 <= time.monotonic() - before < 5.0


def test_the_first_event_ends_the_waiting():
    inbox, _ = inbox_of()
    writer = threading.Timer(0.02, inbox.put, [Joined("a")])
    writer.start()
    assert inbox.take(timeout=10.0) == [Joined("a")]
    writer.join()


def test_events_of_many_threads_all_come_out_each_threads_in_order():
    inbox, counters = inbox_of()

    def write(sender: str) -> None:
        for number in range(500):
            inbox.put(Message(sender, b"%d" % number))

    writers = [threading.Thread(target=write, args=(sender,)) for sender in "abcd"]
    for writer in writers:
        writer.start()
    taken: list[Event] = []
    deadline = time.monotonic() + 10.0
    while len(taken) < 2_000 and time.monotonic() < deadline:
        taken += inbox.take(0.1)
    for writer in writers:
        writer.join()
    for sender in "abcd":
        mine = [event.payload for event in taken if isinstance(event, Message) and event.sender == sender]
        assert mine == [b"%d" % number for number in range(500)]
    assert counters["received"] == 2_000


def test_a_closed_inbox_forgets_and_takes_nothing_more():
    inbox, counters = inbox_of(Joined("a"), Message("a", b"unread"))
    inbox.close()
    inbox.put(Message("a", b"late"))
    assert inbox.take(timeout=10.0) == []
    assert counters["received"] == 1


def test_a_refused_message_is_counted_under_its_reason():
    inbox, counters = inbox_of()
    inbox.refuse("too_long")
    inbox.refuse("too_long")
    assert counters == {"dropped_too_long": 2}
    assert inbox.take() == []
