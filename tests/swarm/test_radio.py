import pytest

from swarm.limits import MIN_MTU
from swarm.radio import LAN, PROFILES


def test_a_radios_channel_is_divided_and_a_lan_is_not():
    radio = PROFILES["digimesh-3hop"]
    assert radio.share(0) == pytest.approx(10_900 / 8)
    assert radio.share(4) == pytest.approx(10_900 / 8 / 5)
    assert LAN.share(4) == LAN.share(0)


def test_what_goes_to_all_takes_the_channel_once_or_each_link_once():
    assert PROFILES["digimesh-1hop"].cost(84, 4, to_all=True) == 84
    assert LAN.cost(84, 4, to_all=True) == 336
    assert LAN.cost(84, 4, to_all=False) == LAN.cost(84, 0, to_all=True) == 84


@pytest.mark.parametrize("name", PROFILES)
def test_every_profile_can_carry_the_protocol(name):
    profile = PROFILES[name]
    assert profile.mtu >= MIN_MTU
    assert profile.queue >= profile.update
