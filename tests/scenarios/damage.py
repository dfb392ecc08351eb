"""What can become of bytes: of a payload on its way, of a state file when its process dies."""

from __future__ import annotations

import random
import shutil
from dataclasses import fields, replace
from pathlib import Path
from typing import Literal

from agent.keeper import Keeper
from swarm.drops import Drop
from swarm.messages import Control, Message, Session, decode, encode

Damage = Literal["none", "lost", "truncated", "flipped"]
"""What becomes of a state file when its process dies."""


def mutated(payload: bytes, chance: random.Random) -> bytes:
    """The payload with a field that says something else, or with any bytes changed or missing; never longer."""
    if chance.random() < 0.5:
        try:
            return encode(bent(decode(payload), chance))[: len(payload)]
        except (Drop, AssertionError):  # it was none, or is none any more
            pass
    changed = bytearray(payload)
    for _ in range(chance.randint(1, 3)):
        changed[chance.randrange(len(changed))] = chance.randrange(256)
    return bytes(changed[: chance.randint(1, len(changed))] if chance.random() < 0.2 else changed)


def bent(message: Message, chance: random.Random) -> Message:
    """A message in which one field is a little off: well-formed, and wrong."""
    name = chance.choice([each.name for each in fields(message)])
    value = getattr(message, name)
    if isinstance(value, int):
        return replace(message, **{name: value + chance.choice([-20, -1, 1, 20])})
    changed = bytearray(value)
    if changed:
        changed[chance.randrange(len(changed))] ^= chance.choice([1, 2, 4])
    return replace(message, **{name: bytes(changed)})


def is_a_lie(payload: bytes) -> bool:
    """Whether a damaged payload states a fact that only its author can know: without keys it would be believed."""
    try:
        return isinstance(decode(payload), Session | Control)
    except Drop:
        return False


def kill(keeper: Keeper, folder: Path) -> None:
    """Leave of a keeper's file what a killed process leaves: what was written by then, in another folder."""
    shutil.copytree(keeper.path.parent, folder, ignore=shutil.ignore_patterns("*.lock", "*-shm"))
    keeper.close()
    shutil.rmtree(keeper.path.parent)


def damaged(path: Path, damage: Damage, chance: random.Random) -> None:
    """Damage a state file, and the log beside it."""
    if damage == "lost":
        shutil.rmtree(path.parent)
        return
    for part in sorted(path.parent.glob(f"{path.name}*")):
        content = bytearray(part.read_bytes())
        if damage == "truncated":
            del content[chance.randint(0, len(content)) :]
        elif damage == "flipped" and content:
            for _ in range(round(10 ** chance.uniform(0, 2))):
                content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
        part.write_bytes(content)
