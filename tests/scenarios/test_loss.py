"""Loss alone: how long five peers on a LAN take to agree, over many seeds."""

import numpy as np
import pytest

from transport.in_process import Network


def settling(make_swarm, seed, loss):
    """Seconds until four robots and an observer agree after two seconds of driving."""
    swarm = make_swarm(Network(seed=seed, loss=loss, delay=(0.001, 0.02)), tick=0.005)
    for name in ("r1", "r2", "r3", "r4"):
        swarm.robot(name)
    swarm.observer("o")
    swarm.drive(2.0, seed=seed)
    return swarm.settle(600.0)


@pytest.mark.parametrize(("loss", "most"), [(0.1, 3.0), (0.3, 15.0), (0.5, 300.0)])
def test_five_peers_agree_soon_whatever_is_lost(make_swarm, loss, most):
    assert np.quantile([settling(make_swarm, seed, loss) for seed in range(3)], 0.95) <= most


@pytest.mark.soak
@pytest.mark.parametrize(("loss", "most"), [(0.1, 3.0), (0.3, 15.0), (0.5, 300.0)])
def test_nineteen_times_in_twenty_five_peers_agree_soon(make_swarm, loss, most):
    times = [settling(make_swarm, seed, loss) for seed in range(200)]
    print(
        f"\nloss {loss:.0%}: median {np.median(times):.2f} s, p95 {np.quantile(times, 0.95):.2f}, max {max(times):.2f}"
    )
    assert np.quantile(times, 0.95) <= most
