from swarm.jitter import Jitter
from swarm.timers import Timers
from swarm.trickle import Trickle

TIMERS = Timers(digest_min=0.1, digest_max=1.6, digest_redundancy=2)


def times_spoken(trickle, until, *, hears=0):
    """When the timer speaks, if it is polled just when it asks to be."""
    spoken, now = [], 0.0
    while (now := trickle.wake_at) <= until:
        if trickle.poll(now):
            spoken.append(now)
        for _ in range(hears):
            trickle.consistent()
    return spoken


def new(seed=b"s"):
    return Trickle(TIMERS, Jitter(seed), 0.0)


def test_it_speaks_once_in_the_second_half_of_each_interval_and_intervals_double():
    ends, begin, length = [], 0.0, 0.1
    while begin < 9:
        ends.append((begin + length / 2, begin + length))
        begin, length = begin + length, min(2 * length, 1.6)
    spoken = times_spoken(new(), ends[-1][1] - 1e-9)
    assert len(spoken) == len(ends)
    assert all(first <= now < last for now, (first, last) in zip(spoken, ends, strict=True))


def test_it_is_silent_while_enough_others_say_the_same():
    assert times_spoken(new(), 20.0, hears=2)[1:] == []
    assert len(times_spoken(new(), 20.0, hears=0)) > 10


def test_one_other_voice_is_not_enough():
    trickle = new()
    trickle.consistent()
    assert trickle.poll(trickle.wake_at)


def test_voices_of_the_last_interval_do_not_count():
    trickle = new()
    trickle.consistent()
    trickle.consistent()
    assert not trickle.poll(trickle.wake_at)
    assert not trickle.poll(trickle.wake_at)  # the interval's end
    assert trickle.poll(trickle.wake_at)


def test_news_make_it_quick_again():
    trickle = new()
    times_spoken(trickle, 10.0)
    assert trickle.wake_at - 10.0 > 0.1
    trickle.reset(10.0)
    assert 10.05 <= trickle.wake_at < 10.1


def test_news_do_not_put_off_a_quick_one():
    trickle = new()
    due = trickle.wake_at
    trickle.reset(0.01)
    assert trickle.wake_at == due


def test_peers_with_different_seeds_speak_at_different_moments():
    assert len({new(bytes([seed])).wake_at for seed in range(50)}) == 50


def test_polled_late_it_speaks_once():
    trickle = new()
    assert trickle.poll(50.0)
    assert not trickle.poll(50.0)
    assert trickle.wake_at > 50.0
