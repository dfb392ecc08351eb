"""All that a peer pursues: one catch-up a session, no more of them asking at once than the network bears."""

from __future__ import annotations

from collections.abc import Mapping

from swarm.catch_up import CatchUp
from swarm.drops import Drop
from swarm.jitter import Jitter
from swarm.limits import MAX_SESSIONS
from swarm.messages import Manifest, Need, TilesMessage, Want
from swarm.replica import Replica
from swarm.session import SessionId
from swarm.state import State
from swarm.timers import Timers

_NEVER = float("inf")


class Pursuits:
    """The catch-ups of one peer; one that rests with nothing in hand is forgotten.

    Args:
        timers: how long to wait, and how many may ask at once.
        jitter: chance.
        mtu: the longest payload, in bytes.
    """

    def __init__(self, timers: Timers, jitter: Jitter, mtu: int) -> None:
        self._timers = timers
        self._jitter = jitter
        self._mtu = mtu
        self._catch_ups: dict[SessionId, CatchUp] = {}

    def __len__(self) -> int:
        return len(self._catch_ups)

    # --- what is known of others

    def heard(self, session: SessionId, peer: str, n: int, mine: int, now: float) -> None:
        """A peer holds state ``n`` of a session, more than ours; see ``CatchUp.heard``.

        Raises:
            Drop: ``too_many`` sessions are pursued.
        """
        self._of(session).heard(peer, n, mine, now)

    def gone(self, peer: str, now: float) -> None:
        """A peer has left: ask others."""
        for catch_up in self._catch_ups.values():
            catch_up.gone(peer, now)

    def most(self, session: SessionId) -> int:
        """The latest state of a session that anybody is known to hold, -1 if nobody is."""
        catch_up = self._catch_ups.get(session)
        return -1 if catch_up is None else catch_up.most

    # --- asking

    @property
    def wake_at(self) -> float:
        """When ``poll`` wants to be called next."""
        times = [each.wake_at for each in self._catch_ups.values() if each.asking]
        if len(times) < self._timers.fetches:  # else nobody may begin before one of them is done
            times = [each.wake_at for each in self._catch_ups.values()]
        return min(times, default=_NEVER)

    def poll(self, replicas: Mapping[SessionId, Replica], now: float) -> list[tuple[str, Want | Need]]:
        """The requests for which it is time, the most overdue first, and to whom each goes."""
        due = sorted((each.wake_at, session) for session, each in self._catch_ups.items() if now >= each.wake_at)
        for _, session in due:
            self._catch_ups[session].expire(now)
        asking = sum(each.asking for each in self._catch_ups.values()) if due else 0
        requests = []
        for _, session in due:
            catch_up = self._catch_ups[session]
            if asking >= self._timers.fetches and not catch_up.asking:
                continue
            asking -= catch_up.asking
            if (request := catch_up.poll(replicas.get(session), now)) is not None:
                requests.append(request)
            asking += catch_up.asking
            self._forget_if_idle(session)
        return requests

    # --- answers

    def offer(self, peer: str, message: Manifest | TilesMessage, mine: State, now: float) -> State | None:
        """Take an answer; see ``CatchUp.offer``.

        Raises:
            Drop: ``not_asked`` too if the session is not pursued.
        """
        catch_up = self._catch_ups.get(message.session)
        if catch_up is None:
            raise Drop("not_asked")
        return catch_up.offer(peer, message, mine, now)

    def advanced(self, session: SessionId, mine: int, now: float) -> None:
        """Our copy of a session has just moved on to ``mine``."""
        catch_up = self._catch_ups.get(session)
        if catch_up is not None:
            catch_up.advanced(mine, now)
            self._forget_if_idle(session)

    def start_over(self, session: SessionId, peer: str, wrong: State, now: float) -> None:
        """Our copy of a session proved wrong and is empty now; what was sound of it is not fetched again."""
        catch_up = self._of(session)
        catch_up.keep(wrong.sound_tiles())
        catch_up.heard(peer, wrong.n, 0, now)
        self.advanced(session, 0, now)

    def forget(self, session: SessionId) -> None:
        """A session is not wanted any more."""
        self._catch_ups.pop(session, None)

    def _of(self, session: SessionId) -> CatchUp:
        if session not in self._catch_ups:
            if len(self._catch_ups) >= MAX_SESSIONS:
                raise Drop("too_many")
            self._catch_ups[session] = CatchUp(session, self._timers, self._jitter, self._mtu)
        return self._catch_ups[session]

    def _forget_if_idle(self, session: SessionId) -> None:
        if self._catch_ups[session].idle:
            del self._catch_ups[session]
