import numpy as np
import pytest

from mapping.evidence import EvidenceModel
from mapping.lattice import Lattice, TileKey
from mapping.raster import raster
from mapping.sensor import orion
from mapping.tiles import frozen
from swarm import catch_up as catch_up_module
from swarm.catch_up import CatchUp
from swarm.drops import Drop
from swarm.jitter import Jitter
from swarm.messages import Manifest, Mark, Need, TilesMessage, Update, Want
from swarm.replica import WINDOW, Replica
from swarm.session import Descriptor, Rules
from swarm.state import tile_hash
from swarm.tile_block import encode_tile
from swarm.timers import Timers

SESSION = b"session1"
DESCRIPTOR = Descriptor("r1", SESSION, Rules(Lattice(50), EvidenceModel()), orion(), None)
TIMERS = Timers(jitter=(0.1, 0.3), retry=1.0, retry_max=3.0, backoff=1.3, give_up=8)


def tile(value):
    cells = np.zeros((32, 32), np.int32)
    cells[0, 0] = value
    return frozen(cells)


def written(count):
    """A replica after so many updates of one new tile each, and these."""
    replica, updates = Replica(DESCRIPTOR, raster), []
    for n in range(1, count + 1):
        key, cells = TileKey(0, n), tile(n)
        updates.append(replica.write(Update.TILES, encode_tile(key, cells), {key: cells})[0])
    return replica, updates


class Pursuit:
    """A catch-up, the copy it is for, and a clock."""

    def __init__(self, seed=b"seed", mtu=32768):
        self.catch_up = CatchUp(SESSION, TIMERS, Jitter(seed), mtu)
        self.replica = Replica(DESCRIPTOR, raster)
        self.now = 0.0
        self.asked = "a"

    def hear(self, peer, n):
        self.catch_up.heard(peer, n, self.replica.state.n, self.now)

    def ask(self):
        """Wait until it asks: whom, for what."""
        for _ in range(100):
            assert not self.catch_up.resting
            self.now = max(self.now, self.catch_up.wake_at)
            request = self.catch_up.poll(self.replica, self.now)
            if request is not None:
                self.asked = request[0]
                return request
        raise AssertionError

    def take(self, *updates):
        for update in updates:
            for _ in self.replica.offer(update):
                pass
            self.catch_up.advanced(self.replica.state.n, self.now)

    def offer(self, message, peer=None):
        """Hear a message, from whom was asked last unless somebody else is named."""
        state = self.catch_up.offer(peer or self.asked, message, self.replica.state, self.now)
        if state is not None:
            self.replica.install(state)
            self.catch_up.advanced(self.replica.state.n, self.now)
        return state


def drop(pursuit, message, peer=None):
    before = pursuit.replica.state.root()
    with pytest.raises(Drop) as caught:
        pursuit.offer(message, peer)
    assert pursuit.replica.state.root() == before
    return caught.value.reason


def test_a_gap_is_asked_about_after_a_little_while():
    pursuit = Pursuit()
    pursuit.hear("a", 3)
    assert 0.1 <= pursuit.catch_up.wake_at < 0.3
    assert pursuit.catch_up.poll(pursuit.replica, 0.05) is None
    assert pursuit.ask() == ("a", Want(SESSION, 0, 0))


def test_a_gap_that_closes_by_itself_is_not_asked_about():
    pursuit = Pursuit()
    pursuit.hear("a", 3)
    pursuit.take(*written(3)[1])
    assert pursuit.catch_up.resting
    assert pursuit.catch_up.poll(pursuit.replica, 100.0) is None


def test_only_what_is_missing_is_wanted():
    pursuit, (_, updates) = Pursuit(), written(9)
    pursuit.take(*updates[:2])
    pursuit.hear("a", 9)
    pursuit.take(*updates[5:9])
    assert pursuit.ask() == ("a", Want(SESSION, 2, 5))


def test_whoever_lacks_the_descriptor_says_so():
    catch_up = CatchUp(SESSION, TIMERS, Jitter(b""), 32768)
    catch_up.heard("a", 0, -1, 0.0)
    assert catch_up.poll(None, 1.0) == ("a", Want(SESSION, -1, 0))


def test_without_an_answer_somebody_else_is_asked_ever_more_patiently():
    pursuit = Pursuit()
    pursuit.hear("a", 3)
    pursuit.hear("b", 3)
    asked, times = [], []
    for _ in range(4):
        asked.append(pursuit.ask()[0])
        times.append(pursuit.now)
    assert sorted(asked[:2]) == sorted(asked[2:]) == ["a", "b"]
    waits = np.diff(times)
    assert waits == pytest.approx([1.0, 1.3, 1.69])


def test_waits_are_bounded():
    pursuit = Pursuit()
    for peer in "abcdef":
        pursuit.hear(peer, 3)
    times = []
    for _ in range(30):
        pursuit.ask()
        times.append(pursuit.now)
    assert np.diff(times).max() == pytest.approx(3.0)


def test_who_fails_too_often_is_not_asked_until_it_speaks():
    pursuit = Pursuit()
    pursuit.hear("a", 3)
    for _ in range(8):
        assert pursuit.ask()[0] == "a"
    assert pursuit.catch_up.poll(pursuit.replica, pursuit.catch_up.wake_at) is None
    assert pursuit.catch_up.resting
    pursuit.hear("a", 3)
    assert pursuit.ask()[0] == "a"


def test_who_leaves_is_not_waited_for():
    pursuit = Pursuit()
    pursuit.hear("a", 3)
    pursuit.hear("b", 3)
    asked, _ = pursuit.ask()
    at = pursuit.now
    pursuit.catch_up.gone(asked, at)
    assert pursuit.ask()[0] != asked
    assert pursuit.now == at


def test_when_the_only_one_leaves_it_rests():
    pursuit = Pursuit()
    pursuit.hear("a", 3)
    pursuit.ask()
    pursuit.catch_up.gone("a", pursuit.now)
    assert pursuit.catch_up.poll(pursuit.replica, pursuit.now) is None
    assert pursuit.catch_up.resting


def test_after_a_window_of_updates_the_next_is_asked_for_at_once():
    pursuit, (provider, updates) = Pursuit(), written(39)
    pursuit.hear("a", 39)
    assert pursuit.ask() == ("a", Want(SESSION, 0, 0))
    at = pursuit.now
    pursuit.take(*updates[:WINDOW])
    assert pursuit.ask() == ("a", Want(SESSION, WINDOW, 0))
    assert pursuit.now == at
    pursuit.take(*provider.answer(Want(SESSION, WINDOW, 0)))
    assert pursuit.catch_up.resting


def pursuing(count=45, mtu=32768):
    """A pursuit of a large gap, up to the request for tiles."""
    pursuit, (provider, updates) = Pursuit(mtu=mtu), written(count)
    for peer in "abc":
        pursuit.hear(peer, count)
    _, want = pursuit.ask()
    [manifest] = provider.answer(want)
    assert pursuit.offer(manifest) is None
    return pursuit, provider, updates, manifest


def tiles_message(*entries):
    return TilesMessage(SESSION, b"".join(encode_tile(key, cells) for key, cells in entries))


def test_a_large_gap_is_closed_by_a_manifest_and_tiles():
    pursuit, provider, _, manifest = pursuing()
    _, need = pursuit.ask()
    assert dict(need.wanted()) == {key: mark.hash for key, mark in provider.checkpoint.marks.items()}
    [tiles] = provider.supply(need, 32768)
    assert pursuit.offer(tiles).root() == manifest.root
    assert pursuit.replica.state.n == 40
    assert pursuit.ask()[1] == Want(SESSION, 40, 0)


def test_tiles_that_are_here_already_are_not_asked_for():
    pursuit, (provider, updates) = Pursuit(), written(45)
    pursuit.take(*updates[:10])
    pursuit.hear("a", 45)
    [manifest] = provider.answer(pursuit.ask()[1])
    assert len(manifest.marks()) == 30
    pursuit.offer(manifest)
    assert {key.tx for key, _ in pursuit.ask()[1].wanted()} == {*range(11, 41)}


def test_nothing_is_lost_while_nobody_answers():
    """With most of all payloads lost, eight unanswered requests in a row are nothing rare."""
    pursuit, provider, _, manifest = pursuing()
    need = pursuit.ask()[1]
    pursuit.offer(tiles_message(*[(key, provider.checkpoint.cells[key]) for key, _ in [*need.wanted()][:25]]))
    while not pursuit.catch_up.resting:
        pursuit.catch_up.poll(pursuit.replica, pursuit.catch_up.wake_at)
    assert not pursuit.catch_up.idle
    pursuit.hear("b", 45)
    assert pursuit.offer(manifest, "a") is None  # it was on its way for long, from one that was asked
    _, need = pursuit.ask()
    assert len([*need.wanted()]) == 15
    for message in provider.supply(need, 32768):
        pursuit.offer(message)
    assert pursuit.replica.state.n == 40
    pursuit.take(*provider.answer(Want(SESSION, 40, 0)))
    assert pursuit.catch_up.idle


def test_a_need_fits_the_mtu_and_the_next_follows_at_once():
    pursuit, provider, _, manifest = pursuing(mtu=84)
    at, requests = pursuit.now, 0
    while pursuit.replica.state.n == 0:
        _, need = pursuit.ask()
        requests += 1
        assert isinstance(need, Need)
        assert len([*need.wanted()]) <= 3
        for message in provider.supply(need, 84):
            pursuit.offer(message)
    assert requests == 14
    assert pursuit.now == at
    assert pursuit.replica.state.root() == manifest.root


def test_neither_a_retry_nor_another_provider_loses_a_tile():
    pursuit, provider, _, _ = pursuing()
    asked, need = pursuit.ask()
    some = [*need.wanted()]
    got = [(key, provider.checkpoint.cells[key]) for key, _ in some[:25]]
    pursuit.offer(tiles_message(*got))
    pursuit.catch_up.gone(asked, pursuit.now)
    other, need = pursuit.ask()
    assert other != asked
    assert [*need.wanted()] == some[25:]
    for _ in range(3):  # nobody answers: after a while the state is asked for anew
        request = pursuit.ask()[1]
    assert isinstance(request, Want)
    [manifest] = provider.answer(request)
    pursuit.offer(manifest)
    assert [*pursuit.ask()[1].wanted()] == some[25:]


def test_a_newer_manifest_replaces_the_one_at_hand_and_keeps_the_tiles():
    pursuit, _, _, _ = pursuing()
    _, need = pursuit.ask()
    later, _ = written(65)
    pursuit.offer(tiles_message(*[(key, later.state.cells[key]) for key, _ in [*need.wanted()][:25]]))
    pursuit.offer(later.manifest(0))
    _, need = pursuit.ask()
    assert {key.tx for key, _ in need.wanted()} == {*range(26, 61)}
    pursuit.offer(next(later.supply(need, 1 << 20)))
    assert pursuit.replica.state.n == 60


def test_a_copy_that_moves_on_while_it_fetches_still_comes_out_right():
    pursuit, provider, updates, manifest = pursuing()
    _, need = pursuit.ask()
    pursuit.take(*updates[:7])
    [tiles] = provider.supply(need, 32768)
    assert pursuit.offer(tiles).root() == manifest.root


def test_a_copy_that_overtakes_its_manifest_drops_it():
    pursuit, provider, updates, _ = pursuing()
    _, need = pursuit.ask()
    pursuit.take(*updates[:41])
    [tiles] = provider.supply(need, 32768)
    assert drop(pursuit, tiles) == "not_asked"


def test_what_was_not_asked_for_is_dropped():
    provider, _ = written(45)
    pursuit = Pursuit()
    assert drop(pursuit, provider.manifest(0)) == "not_asked"
    assert drop(pursuit, tiles_message((TileKey(0, 1), tile(1)))) == "not_asked"


def test_a_manifest_counts_only_from_a_peer_that_was_asked_however_late_it_comes():
    pursuit, (provider, _) = Pursuit(), written(45)
    pursuit.hear("a", 45)
    pursuit.hear("b", 45)
    first, _ = pursuit.ask()
    second, _ = pursuit.ask()
    assert {first, second} == {"a", "b"}
    assert drop(pursuit, provider.manifest(0), "stranger") == "not_asked"
    assert pursuit.offer(provider.manifest(0), first) is None
    assert isinstance(pursuit.ask()[1], Need)


def test_tiles_from_anybody_prove_themselves_and_useless_ones_put_nothing_off():
    pursuit, provider, _, manifest = pursuing()
    pursuit.ask()
    waiting = pursuit.catch_up.wake_at
    pursuit.now += 0.5
    assert pursuit.offer(tiles_message((TileKey(9, 9), tile(1))), "stranger") is None
    assert pursuit.catch_up.wake_at == waiting
    everything = tiles_message(*provider.checkpoint.cells.items())
    assert pursuit.offer(everything, "stranger").root() == manifest.root


def test_a_manifest_that_is_not_newer_is_stale():
    pursuit, _, updates, manifest = pursuing()
    pursuit.ask()
    assert drop(pursuit, manifest) == "stale"
    pursuit = Pursuit()
    pursuit.take(*updates)
    pursuit.hear("a", 60)
    pursuit.ask()
    assert drop(pursuit, manifest) == "stale"


def test_a_manifest_for_somebody_who_has_more_is_no_use():
    pursuit, (provider, _) = Pursuit(), written(45)
    pursuit.hear("a", 45)
    pursuit.ask()
    assert drop(pursuit, provider.manifest(5)) == "stale"


def forged(provider, n=40, since=0, **marks):
    entries = Manifest.pack(marks["marks"]) if marks else Manifest.pack(provider.checkpoint.marks)
    return Manifest(SESSION, n, since, provider.checkpoint.root(), entries)


@pytest.mark.parametrize("version", [0, 41])
def test_a_manifest_with_an_impossible_version_is_dropped(version):
    pursuit, (provider, _) = Pursuit(), written(45)
    pursuit.hear("a", 45)
    pursuit.ask()
    assert drop(pursuit, forged(provider, marks={TileKey(0, 1): Mark(version, 1)})) == "bad_payload"


def test_a_manifest_of_too_many_tiles_is_dropped(monkeypatch):
    monkeypatch.setattr(catch_up_module, "MAX_TILES", 39)
    pursuit, (provider, _) = Pursuit(), written(45)
    pursuit.hear("a", 45)
    pursuit.ask()
    assert drop(pursuit, provider.manifest(0)) == "too_many"


def test_a_tile_of_another_content_is_dropped_and_good_ones_beside_it_are_kept():
    pursuit, _, _, _ = pursuing()
    _, need = pursuit.ask()
    assert drop(pursuit, tiles_message((TileKey(0, 1), tile(1)), (TileKey(0, 2), tile(99)))) == "bad_hash"
    for _ in range(9):
        _, need = pursuit.ask()
        if isinstance(need, Need):
            break
    assert TileKey(0, 1) not in dict(need.wanted())
    assert TileKey(0, 2) in dict(need.wanted())


def test_tiles_that_nobody_needs_do_no_harm():
    pursuit, _, _, _ = pursuing()
    pursuit.ask()
    assert pursuit.offer(tiles_message((TileKey(9, 9), tile(1)))) is None


def test_tiles_that_do_not_add_up_to_the_root_are_dropped():
    pursuit, (provider, _) = Pursuit(), written(45)
    pursuit.hear("a", 45)
    pursuit.ask()
    marks = {TileKey(0, 1): Mark(1, tile_hash(TileKey(0, 1), tile(1)))}
    pursuit.offer(forged(provider, marks=marks))
    pursuit.ask()
    assert drop(pursuit, tiles_message((TileKey(0, 1), tile(1)))) == "bad_root"


def test_tiles_kept_from_a_wrong_copy_are_not_fetched_again():
    pursuit, (provider, _) = Pursuit(), written(45)
    pursuit.catch_up.keep(
        {(key, mark.hash): provider.checkpoint.cells[key] for key, mark in provider.checkpoint.marks.items()}
    )
    pursuit.hear("a", 45)
    pursuit.ask()
    assert pursuit.offer(provider.manifest(0)).n == 40


def test_a_manifest_for_somebody_who_has_less_asks_only_for_what_is_not_here():
    pursuit, (provider, updates) = Pursuit(), written(45)
    pursuit.take(*updates[:10])
    pursuit.hear("a", 45)
    pursuit.ask()
    pursuit.offer(provider.manifest(0))
    assert {key.tx for key, _ in pursuit.ask()[1].wanted()} == {*range(11, 41)}
