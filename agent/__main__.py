"""``python -m agent`` is ``orion``."""

from agent.cli import main

main()
