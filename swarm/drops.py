"""Why something that came in was dropped: every reason by name, so that it can be counted, shown and tested."""

from __future__ import annotations

REASONS = {
    "too_long": "the payload is longer than any message may be",
    "not_msgpack": "the payload is no single flat msgpack array",
    "other_version": "the message speaks another version of the protocol",
    "unknown_kind": "this version knows no such message",
    "bad_shape": "the message has the wrong number or types of fields",
    "out_of_range": "a field lies outside its limits",
    "bad_part": "the parts of a long message do not fit together",
    "bad_descriptor": "a session's descriptor does not parse, or contradicts the one already known",
    "bad_control": "a control record's subject or value is none of its setting",
    "bad_payload": "an update's or tile's content does not decode",
    "bad_check": "the state after an update is not the one that its writer had",
    "bad_hash": "a tile is not the one that was asked for",
    "bad_root": "a manifest's tiles do not add up to its root",
    "not_asked": "an answer that nobody waits for",
    "stale": "an update, state or control record that is already here, or a later one",
    "too_far_ahead": "an update beyond what is kept while a gap is open; it is asked for again later",
    "unknown_session": "about a session whose descriptor (or its predecessor's) is not here yet; it is asked for",
    "refused_session": "of a session that cannot be summed with ours (see the reason kept with it)",
    "replaced_session": "of a session in whose place its robot has opened another one",
    "own_session": "somebody else speaks for a session that only we write",
    "too_many": "a limit on sessions, tiles, control records or parts is reached",
}


class Drop(Exception):  # noqa: N818 - it is no error of ours
    """What a peer said is dropped, for a named reason. Never leaves ``Peer.receive``."""

    def __init__(self, reason: str) -> None:
        assert reason in REASONS
        self.reason = reason
        super().__init__(REASONS[reason])
