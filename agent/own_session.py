"""What a robot contributes: its journal, published in its session, and made right afterwards when more is known.

Laws kept here: what is published follows from the journal, the start pose in force and the team-mates' tracks, and from
nothing else. So a robot that learns another start pose opens a session that replaces its own and publishes its journal
again in it; and the map after any corrections equals, cell for cell, that of a run that had all of it right from the
start. Publishing anew is publishing: there are only rows that the session has and rows that it has not yet. A step is
bounded, so that the robot keeps hearing.
"""

from __future__ import annotations

import secrets
from collections import Counter
from collections.abc import Callable

import numpy as np

from agent.body import Body
from agent.column import Column
from agent.journal import Journal, Past
from agent.readings import FARTHEST_START_MM
from agent.team_mates import Masks, NoMates, TeamMates, without
from mapping.pose import QuantisedPose
from mapping.raster import Raster
from mapping.scan import Scans
from mapping.tiles import Evidence, Tiles, added, merged
from swarm.peer import Peer
from swarm.session import Descriptor, SessionId
from swarm.writer import Publish, Writer

OWN_FRAME = QuantisedPose(0, 0, 0)
"""Where a robot maps whose start pose nobody knows: its start frame is taken for the common one; nobody sums it."""

_UPDATES = 2
"""What the writer is given between two publications, in updates that are as dear as one may be (``MAX_VISITS``)."""

_MOST_ROWS = 4096
"""Scans that it is given likewise: of a few beams each, whose masks cost more than their evidence."""

_CORRECTED_ROWS = 1024
"""Scans that are looked over again in one step."""


class OwnSession:
    """The one session that this robot writes now.

    Args:
        peer: whose session it is.
        robot: its id.
        body: what senses; it is placed when the start pose is known, and again whenever it changes.
        mates: what is known of the others.
        start: the start pose that the configuration gives; a control record for this robot is stronger.
        publish: the form of its updates.
        kernel: for corrections; see ``mapping.raster``.
        past: an earlier run's readings: then the session is that run's, and the body senses nothing.
        new_id: gives sessions their ids.

    Attributes:
        journal: what was sensed.
        run: the name of the run in which it was: the id of its first session.
        writer: the session's.
        status: what is wrong, in words; empty if nothing is.
        counters: ``masked`` readings when they were handed to the writer; ``corrected`` scans afterwards;
            ``uncorrectable`` ones, because evidence has a limit and cannot be taken back; ``replaced`` sessions.
    """

    def __init__(
        self,
        peer: Peer,
        robot: str,
        body: Body,
        *,
        mates: TeamMates | NoMates,
        start: QuantisedPose | None,
        publish: Publish,
        kernel: Raster,
        past: Past | None = None,
        new_id: Callable[[], SessionId] = lambda: secrets.token_bytes(8),
    ) -> None:
        self.journal = Journal(body.sensor)
        self.status = ""
        self.counters: Counter[str] = Counter()
        self._peer = peer
        self._robot = robot
        self._body = body
        self._mates = mates
        self._configured = start
        self._form = publish
        self._kernel = kernel
        beams = len(body.sensor.beams)
        self._masks = Column(np.bool_, (beams,))  # of the rows that the session has, as it has them
        self._doubtful = Column(np.bool_)  # of the same rows: news of team-mates may concern them
        self._handed = 0  # rows that the writer was given since it last published
        self._owed = 0  # rows that the sessions had which this one replaces
        self._new_id = new_id
        self._past = past
        self.writer: Writer
        if past is None:
            self._open(self._start_in_force(), None)
            self.run = self.descriptor.session
        else:
            self.journal.append(past.readings)
            self._owed = len(past.readings)
            self._open(past.start, past.replaces)
            self.run = past.run

    # --- the session

    @property
    def descriptor(self) -> Descriptor:
        """The session's."""
        return self.writer.replica.descriptor

    @property
    def map(self) -> Tiles:
        """The map to drive by: the swarm's, or the robot's own as long as nobody knows where that lies."""
        return self._peer.fusion.tiles if self.placed else self.writer.replica.state.cells

    @property
    def placed(self) -> bool:
        """Whether it is known where the robot started."""
        return self.descriptor.start is not None

    @property
    def settled(self) -> bool:
        """Whether all that was sensed is published, as it is known to be right."""
        return not (self.unpublished or self.writer.waiting or self._doubtful.rows.any())

    @property
    def whole(self) -> bool:
        """Whether the session holds all that the sessions held which it replaces."""
        return len(self._masks) >= self._owed and not self.writer.waiting

    @property
    def unpublished(self) -> int:
        """Scans that the writer has not been given yet."""
        return len(self.journal) - len(self._masks)

    @property
    def _is_over(self) -> bool:
        """Whether somebody else has taken the session's place: then nobody would hear what is published in it."""
        over = self._peer.writer is not self.writer
        if over:
            self.status = f"another {self._robot} has replaced this one's session: see to it that there is only one"
        return over

    def _start_in_force(self) -> QuantisedPose | None:
        if self._past is not None:
            return self._past.start
        record = self._peer.controls.start_pose(self._robot)
        if record is None:
            return self._configured
        x_mm, y_mm, _ = record.pose
        if max(abs(x_mm), abs(y_mm)) > FARTHEST_START_MM:
            self.status = f"the start pose ({x_mm / 1000:g} m, {y_mm / 1000:g} m) is too far out and does not count"
            return self._configured
        self.status = ""
        return record.pose

    def _open(self, start: QuantisedPose | None, replaces: bytes | None) -> None:
        rules = self._peer.rules
        descriptor = Descriptor(self._robot, self._new_id(), rules, self.journal.sensor, start, replaces)
        self.writer = self._peer.open_session(descriptor, self._form)
        self._most_rows = min(_MOST_ROWS, _UPDATES * descriptor.most_scans)
        self._owed = max(self._owed, len(self._masks))
        self._masks.clear()
        self._doubtful.clear()
        self._handed = 0
        self._body.place(self._frame)

    @property
    def _frame(self) -> QuantisedPose:
        return self.descriptor.start or OWN_FRAME

    # --- publishing

    def reopen(self) -> None:
        """Begin anew in a session that replaces this one, for another was written since."""
        self._open(self._start_in_force(), self.descriptor.session)

    def publish(self) -> None:
        """Hand the writer what it has not had yet, as much as is good for one publication.

        If another start pose is in force than the session's, a session that replaces it begins, and with it all anew.
        """
        if self._is_over:
            return
        start = self._start_in_force()
        if start != self.descriptor.start:
            self.counters["replaced"] += 1
            self._open(start, self.descriptor.session)
        if not self.writer.waiting:
            self._handed = 0
        count = min(self.unpublished, self._most_rows - self._handed)
        if count <= 0:
            return
        rows = np.arange(count) + len(self._masks)
        scans = self.journal.scans(self._frame, rows)
        masks = self._masks_of(scans)
        self.writer.sense(without(scans, masks))
        self.counters["masked"] += int(masks.sum())
        self._masks.append(masks)
        self._doubtful.append(np.zeros(len(rows), np.bool_))
        self._handed += len(rows)

    def _masks_of(self, scans: Scans) -> Masks:
        """Which readings fell on a team-mate; a robot that is not placed does not know."""
        return self._mates.masks(scans) if self.placed else np.zeros(scans.ranges.shape, np.bool_)

    # --- correcting

    def correct(self, now: float) -> None:
        """Publish what news of team-mates changes in what is published already, as changed cells.

        Not while scans wait, on which it does not count; and not more in one step than keeps the robot hearing.
        """
        self._doubt()
        if self.writer.waiting or self._is_over:
            return
        rows = np.flatnonzero(self._doubtful.rows)[:_CORRECTED_ROWS]
        if not len(rows):
            return
        self._doubtful.rows[rows] = False
        sensed = self.journal.scans(self._frame, rows)
        before, after = self._masks.rows[rows], self._masks_of(sensed)
        wrong = (before != after).any(axis=1)
        if not wrong.any():
            return
        self._masks.rows[rows[wrong]] = after[wrong]
        if self._peer.rules.model.limit:
            self.counters["uncorrectable"] += int(wrong.sum())
            return
        self.counters["corrected"] += int(wrong.sum())
        sensed = Scans(sensed.stamps_ms[wrong], sensed.poses[wrong], sensed.ranges[wrong])
        less, more = (self._evidence(without(sensed, masks[wrong])) for masks in (before, after))
        tiles = self.writer.replica.state.cells
        self._peer.correct(added(tiles, merged([more, Evidence(less.keys, -less.cells)])), now)

    def _doubt(self) -> None:
        """Mark the rows that news of team-mates concern."""
        for session in self._peer.replaced:
            self._mates.replaced(session)
        spans = self._mates.news()
        if not self.placed:
            return
        stamps_ms = self.journal.stamps_ms[: len(self._masks)]
        for first_ms, last_ms in spans:
            first = np.searchsorted(stamps_ms, first_ms, side="left")
            last = np.searchsorted(stamps_ms, last_ms, side="right")
            self._doubtful.rows[first:last] = True

    def _evidence(self, scans: Scans) -> Evidence:
        rules = self._peer.rules
        return self._kernel(scans, self.journal.sensor, rules.lattice, rules.model)
