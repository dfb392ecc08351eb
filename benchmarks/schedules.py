"""Whole swarms under schedules of faults: does every one agree, how soon, and at what cost?

    python -m benchmarks.schedules --seeds 10000                 # all kinds of faults at once
    python -m benchmarks.schedules --seeds 300 --only loss-30    # five peers, 30 % of all payloads lost
    python -m benchmarks.schedules --fault NAME                  # the first seed that catches a planted fault

A seed whose swarm breaks a law is printed with the least schedule that still breaks it, and the exit status is 1.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from typing import NamedTuple

from tests.scenarios.draw import KINDS
from tests.scenarios.faults import FAULTS
from tests.scenarios.laws import Broken
from tests.scenarios.schedule import Outcome, run
from tests.scenarios.shrink import shrunk


class Result(NamedTuple):
    """What became of one seed: an outcome, or how it broke a law."""

    seed: int
    loss: float
    outcome: Outcome | None
    broken: str


def try_seed(job: tuple[str, int, str | None]) -> Result:
    """Run one seed of a kind, with a planted fault if one is named."""
    kind, seed, fault = job
    schedule = KINDS[kind](seed)
    with ExitStack() as stack:
        if fault is not None:
            stack.enter_context(FAULTS[fault]())
        try:
            return Result(seed, schedule.loss, run(schedule), "")
        except Broken as broken:
            return Result(seed, schedule.loss, None, str(broken))


def least_schedule(kind: str, seed: int, fault: str | None) -> str:
    """The least schedule that breaks the law that this seed breaks."""
    with ExitStack() as stack:
        if fault is not None:
            stack.enter_context(FAULTS[fault]())
        return str(shrunk(KINDS[kind](seed)))


def results(args: argparse.Namespace) -> Iterator[Result]:
    """What becomes of each seed, in order."""
    jobs = [(args.only, seed, args.fault) for seed in range(args.first, args.first + args.seeds)]
    if args.jobs == 1:
        yield from map(try_seed, jobs)
        return
    with multiprocessing.get_context("spawn").Pool(args.jobs) as pool:
        yield from pool.imap(try_seed, jobs, chunksize=4)


class Summary:
    """What all outcomes together say."""

    def __init__(self) -> None:
        self.settled: dict[str, list[float]] = {}
        self.totals: dict[str, Counter[str]] = {"network": Counter(), "events": Counter(), "sent": Counter()}
        self.dropped: Counter[str] = Counter()
        self.count = 0
        self.lasted = 0.0

    def add(self, loss: float, outcome: Outcome) -> None:
        """One more swarm that agreed."""
        self.count += 1
        self.lasted += outcome.lasted
        low = int(loss * 10) * 10
        for name in ("all", f"loss {low:2d}-{low + 10} %"):
            self.settled.setdefault(name, []).append(outcome.settled)
        self.totals["network"] += outcome.network
        self.totals["events"] += outcome.events
        self.totals["sent"] += outcome.sent_bytes
        self.dropped += outcome.dropped

    def lines(self) -> Iterator[str]:
        """For people."""
        yield f"{self.count} schedules agreed; {self.lasted / 3600:.2f} simulated hours"
        yield f"{'seconds to agree':>16} {'schedules':>9} {'median':>8} {'p95':>8} {'max':>8}"
        for name, values in sorted(self.settled.items()):
            values.sort()
            median, p95 = values[len(values) // 2], values[int(len(values) * 0.95)]
            yield f"{name:>16} {len(values):>9} {median:>8.2f} {p95:>8.2f} {values[-1]:>8.2f}"
        for what, counts in (*self.totals.items(), ("dropped", self.dropped)):
            yield f"{what}: " + ", ".join(f"{name} {count}" for name, count in counts.most_common())


def parse() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.schedules", description=__doc__.split("\n", 1)[0])
    parser.add_argument("--seeds", type=int, default=1000, help="how many seeds")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--jobs", type=int, default=2, help="processes at once")
    parser.add_argument("--only", choices=KINDS, default="everything", help="the kind of schedules")
    parser.add_argument("--fault", choices=FAULTS, help="plant this fault, and stop at the first seed that catches it")
    parser.add_argument("--no-shrink", action="store_true", help="do not look for the least schedule")
    return parser.parse_args()


def main() -> int:
    """Run the seeds, say what became of them; the exit status."""
    args = parse()
    began = told = time.monotonic()
    summary, broken = Summary(), []
    for result in results(args):
        if result.outcome is not None:
            summary.add(result.loss, result.outcome)
        else:
            broken.append(result.seed)
            print(f"seed {result.seed} ({args.only}): {result.broken}", flush=True)
            if not args.no_shrink:
                print(least_schedule(args.only, result.seed, args.fault), flush=True)
            if args.fault:
                break
        if time.monotonic() - told > 10:
            told = time.monotonic()
            done = result.seed - args.first + 1
            print(f"{done} of {args.seeds}, {done / (told - began):.1f} a second", file=sys.stderr, flush=True)
    for line in summary.lines():
        print(line)
    print(f"{len(broken)} broke a law" + (f": seeds {broken}" if broken else ""))
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
