"""Mistakes that a swarm could make, planted one at a time into the code that ships: the harness must catch each.

Each fault is a context manager; inside it every peer makes the mistake. Most are mistakes that were made once, here or
in a prototype. A fault that hides (the others' checks heal it before it shows) proves nothing and does not belong here.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from typing import Any
from unittest import mock

import agent.keeper
import agent.state_format
import agent.state_reader
from agent.keeper import Keeper
from agent.own_session import OwnSession
from agent.readings import Readings
from swarm.catch_up import CatchUp
from swarm.controls import Controls
from swarm.drops import Drop
from swarm.fusion import Fusion
from swarm.messages import Control, Manifest, Mark, TilesMessage, Update
from swarm.outbox import Outbox
from swarm.peer import Peer
from swarm.replica import CHECKPOINT, Replica
from swarm.state import State, changed_tiles, state_check
from swarm.tile_block import decode_tiles
from swarm.trickle import Trickle
from swarm.writer import Writer

Fault = Callable[[], AbstractContextManager[None]]

FAULTS: dict[str, Fault] = {}
"""All faults by name."""


def planted(owner: Any, method: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Make a function a fault: it takes the place of a method, which it is given as its first argument."""

    def plant(mistake: Callable[..., Any]) -> Callable[..., Any]:
        @contextmanager
        def fault() -> Iterator[None]:
            right = getattr(owner, method)
            with mock.patch.object(owner, method, lambda *args, **options: mistake(right, *args, **options)):
                yield

        FAULTS[mistake.__name__.replace("_", "-")] = fault
        return mistake

    return plant


# --- following a writer


@planted(Replica, "offer")
def apply_an_update_out_of_order(right, replica, update):
    """An early update is not kept until its turn but applied at once, its check left for later."""
    if update.n <= replica.state.n + 1:
        yield from right(replica, update)
        return
    step = replica.state.step(changed_tiles(replica.state, update, replica.descriptor, replica._kernel))
    change = replica.state.apply(step)
    replica.state.n = update.n
    yield update, change


@planted(Replica, "_apply")
def skip_the_state_check(right, replica, update):
    """An update is believed to lead where its writer went."""
    step = replica.state.step(changed_tiles(replica.state, update, replica.descriptor, replica._kernel))
    return replica._commit(update, step)


@planted(State, "apply")
def half_apply_an_update(right, state, step):
    """Of an update that changes several tiles one is left as it was."""
    if len(step.cells) < 2:
        return right(state, step)
    return right(state, replace(step, cells=dict(list(step.cells.items())[1:])))


@planted(Replica, "drain")
def forget_to_drain_what_came_early(right, replica):
    """Updates that waited for an earlier one wait for ever."""
    return iter(())


@planted(Replica, "offer")
def apply_an_update_twice(right, replica, update):
    """An update that is here already and comes again is added again."""
    if update.n != replica.state.n or update.form != Update.SCANS:
        yield from right(replica, update)
        return
    step = replica.state.step(changed_tiles(replica.state, update, replica.descriptor, replica._kernel))
    yield update, {key: (replica.state.cells.get(key), cells) for key, cells in step.cells.items()}


# --- serving others


@planted(Replica, "_commit")
def trim_the_ring_past_the_checkpoint(right, replica, update, step):
    """The ring is kept short, whatever the checkpoint needs: so nobody between the two can be helped."""
    change = right(replica, update, step)
    for n in [n for n in replica._ring if n <= update.n - CHECKPOINT // 4]:
        del replica._ring[n]
    return change


@planted(Replica, "answer")
def answer_a_want_from_a_newer_state(right, replica, want):
    """A manifest lists the tiles as they are by now, under the number and the root of the checkpoint."""
    for message in right(replica, want):
        if isinstance(message, Manifest):
            newer = {key: mark for key, mark in replica.state.marks.items() if mark.version > message.since}
            marks = {key: Mark(min(mark.version, message.n), mark.hash) for key, mark in newer.items()}
            yield replace(message, entries=Manifest.pack(marks))
        else:
            yield message


@planted(Replica, "manifest")
def forget_a_version_in_a_manifest(right, replica, since):
    """A tile that changed at the checkpoint itself is not listed."""
    manifest = right(replica, since)
    return replace(
        manifest, entries=Manifest.pack({k: m for k, m in manifest.marks().items() if m.version < manifest.n})
    )


@planted(Peer, "_served")
def serve_only_what_is_ones_own(right, peer, session):
    """Others' sessions are not given away: whose writer is gone can be had from nobody."""
    if not peer._writes(session):
        raise Drop("unknown_session")
    return right(peer, session)


@planted(Replica, "_commit")
def never_trim_the_ring(right, replica, update, step):
    """Every update is kept for ever."""
    ring = dict(replica._ring)
    change = right(replica, update, step)
    replica._ring = ring | replica._ring
    return change


# --- catching up


@planted(CatchUp, "_take_tiles")
def accept_a_tile_unchecked(right, catch_up, message: TilesMessage):
    """A tile is taken for what was asked for by its place alone."""
    before = len(catch_up._missing)
    for key, cells in decode_tiles(message.payload).items():
        if key in catch_up._missing:
            catch_up._got[key, catch_up._missing.pop(key)] = cells
            catch_up._requested.discard(key)
    return len(catch_up._missing) < before


@planted(State, "verified")
def take_a_state_before_its_root_is_checked(right, n, marks, cells, root):
    """What a manifest or a file says of a state is believed, as long as each tile is what it should be."""
    return State(n, cells, marks, state_check(n, marks))


@planted(State, "root")
def leave_the_number_out_of_the_root(right, state):
    """A state proves true under any number."""
    return right(replace(state, n=0))


@planted(Replica, "_apply")
def leave_the_number_out_of_the_check(right, replica, update):
    """An update counts as the next one if it leads where its writer went, whichever it is."""
    step = replica.state.step(changed_tiles(replica.state, update, replica.descriptor, replica._kernel))
    if any((step.check - step.n - update.check + n) % 2**64 == 0 for n in range(200)):
        return replica._commit(update, step)
    raise Drop("bad_check")


@planted(Trickle, "poll")
def say_no_digests(right, trickle, now):
    """Nobody says what it holds but to those who come."""
    right(trickle, now)
    return False


@planted(Peer, "_digest")
def ignore_a_digests_session(right, peer, sender, digest, now):
    """What a digest says of sessions that are not known is passed over."""
    known = [(session, n) for session, n in digest.positions().items() if session in peer.descriptors]
    right(peer, sender, digest.of(known, complete=bool(digest.complete), controls=digest.controls), now)


# --- the sum


@planted(Fusion, "add")
def count_an_update_twice(right, fusion, change):
    """A tile that is new to a session goes into the sum twice if somebody else's evidence is there already."""
    again = {key: parts for key, parts in change.items() if parts[0] is None and key in fusion.tiles}
    right(fusion, change)
    right(fusion, again)


@planted(Peer, "_take")
def keep_evicted_evidence(right, peer, control, now):
    """The decision is taken down, but what is in the sum stays there."""
    if not peer.controls.put(control):
        raise Drop("stale")
    peer._controls_at = now
    peer._settled_at = now + peer._timers.settle


@planted(Peer, "_replace")
def keep_replaced_evidence(right, peer, old, new):
    """A session in whose place another one is summed stays in the sum."""
    with mock.patch.object(peer.fusion, "resum"):
        right(peer, old, new)


# --- control records


@planted(Controls, "put")
def accept_an_old_decision_said_again(right, controls, control: Control):
    """Whatever record comes last is in force."""
    known = controls.get(control.setting, control.subject)
    if known is not None and known.revision > control.revision:
        controls.check = (controls.check - _hash_of(controls, known)) % 2**64
        del controls._records[control.setting, control.subject]
    return right(controls, control)


def _hash_of(controls: Controls, control: Control) -> int:
    alone = Controls()
    alone.put(control)
    return alone.check


# --- coming back


@planted(OwnSession, "_open")
def continue_a_session_after_a_restart(right, own, start, replaces):
    """A robot that starts again goes on under the old name."""
    name = hashlib.blake2b(own._robot.encode(), digest_size=8).digest()
    new_id = own._new_id
    if replaces is None and name not in own._peer.descriptors:
        own._new_id = lambda: name
    right(own, start, replaces)
    own._new_id = new_id


@planted(agent.keeper, "read_journal")
def lose_the_journals_tail(right, path, run, sensor):
    """The last scan of an earlier run is not there any more."""
    readings = right(path, run, sensor)
    return Readings(readings.stamps_ms[:-1], readings.poses[:-1], readings.ranges[:-1])


@planted(Keeper, "keep")
def say_before_it_is_kept(right, keeper, peer, sessions, now):
    """What is published is written down only now and then, like everything else."""
    if now >= keeper._look_at:
        right(keeper, peer, sessions, now)


@planted(Keeper, "keep")
def keep_decisions_only_now_and_then(right, keeper, peer, sessions, now):
    """An operator's decision is written down when it suits."""
    if now >= keeper._look_at or (peer.writer is not None and keeper._index.lacks(peer.writer.replica)):
        right(keeper, peer, sessions, now)


# --- writing


@planted(Writer, "sense")
def lose_a_scan(right, writer, scans):
    """The last scan of a large batch is left out."""
    right(writer, scans[:-1] if len(scans) > 3 else scans)


@planted(Outbox, "take")
def forget_to_count_what_was_said(right, outbox, now):
    """What only one peer asked for is not counted."""
    out = right(outbox, now)
    outbox.sent_bytes.subtract(Counter(each.topic for each in out if each.topic == "manifest"))
    return out
